"""Terms of the loss beside each other: by hand arithmetic, in words, and out of a store's checkpoints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.papers.focal_loss.loss_term_claims import Terms, loss_term_claims
from fl3d.papers.focal_loss.recorded import terms_of
from fl3d.reports.verdicts import ONE_SEED
from fl3d.runs.checkpoints import read_marker, write_marker
from tests.analysis.making import detected_sweep

# Positives 8 and 2, negatives 2 and 2, regression 1 and 4: ratios of 4 and 1, and of 10 and 1.
TERMS = Terms(np.array([8.0, 2.0]), np.array([2.0, 2.0]), np.array([1.0, 4.0]))
# A regression of twenty and five hundred times the classification.
APART = Terms(np.array([1.0, 1.0]), np.array([1.0, 1.0]), np.array([40.0, 1000.0]))


def test_each_checkpoint_counts_alike() -> None:
    """The mean of the powers of ten: the root of 4 x 1 is 2, and that of 10 x 1 is 3.16."""
    positives, classification = loss_term_claims([TERMS] * 3, [], [])[:2]
    assert (
        positives.ours == "2.00 [2.00, 2.00] over seeds, 1.00 to 4.00 between checkpoints; 3 seeds"
    )
    assert classification.ours.startswith("3.16 [3.16, 3.16] over seeds, 1.00 to 10.00")
    assert positives.verdict == classification.verdict == "ours: within a factor of 10"


def test_the_original_form_is_asked_for_what_the_paper_says_of_it() -> None:
    imbalance, classification = loss_term_claims([], [], [APART] * 3)[4:]
    assert (imbalance.where, imbalance.printed) == ("§IV-B", "large imbalance")
    assert imbalance.verdict == "ours: within a factor of 10"
    assert classification.verdict == "ours: apart by more than a factor of 10"


def test_a_spread_over_a_factor_of_ten_is_not_told() -> None:
    other = replace(APART, regression=np.array([2.0, 2.0]))
    found = loss_term_claims([APART, other, TERMS], [], [])[1]
    assert found.verdict == "ours: not distinguishable from a factor of 10"


def test_one_seed_has_no_verdict_and_none_says_nothing() -> None:
    found = loss_term_claims([TERMS], [], [])
    assert [claim.verdict for claim in found] == [f"ours: {ONE_SEED}"] * 2 + [""] * 4
    assert {claim.ours for claim in found[2:]} == {""}


def test_terms_are_read_from_checkpoints_of_all_stages(simulated: Path, tmp_path: Path) -> None:
    sweep = detected_sweep(simulated, tmp_path, [["detector=fcn3d", "loss.gamma=0"]], lambda t: 0.0)
    assert terms_of(sweep.trials) == []  # none was recorded
    folders = sweep.trials[0].folders
    for number, folder in enumerate(folders, 1):
        for step in folder.steps():
            losses = {"total": 9.0, "cls_pos": 1.0 * number, "cls_neg": 2.0, "reg": 3.0}
            write_marker(folder, replace(read_marker(folder, step), losses=losses))
    (found,) = terms_of(sweep.trials)
    assert found.positive == pytest.approx(np.arange(1, len(folders) + 1))
    assert found.regression == pytest.approx(3)
