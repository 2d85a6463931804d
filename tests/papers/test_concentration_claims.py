"""Who carries the loss, by hand arithmetic and in words."""

import numpy as np
import pytest

from fl3d.papers.focal_loss.concentration_claims import Carried, carried, concentration_claims
from fl3d.reports.verdicts import ONE_SEED

ALIKE = Carried(hardest=(0.5, 0.9), few=0.95, apart=0.1, moved=(0.1, 0.3), parted=0.2)


def seeds(*models: Carried) -> list[str]:
    return [claim.verdict for claim in concentration_claims(models, models)]


def test_where_all_windows_are_equally_hard_each_carries_its_share() -> None:
    found = carried(np.zeros(1000), np.zeros(2000))
    assert found.hardest == pytest.approx((0.15, 0.15))
    assert found.few == pytest.approx(0.01)
    assert found.apart == pytest.approx(0)
    assert found.moved == pytest.approx((0, 0))
    assert found.parted == pytest.approx(0)


def test_a_hard_tenth_carries_more_under_the_focal_loss() -> None:
    """Positives: a tenth at p_t = 1/3, the others at 2/3; losses ln 3 and ln 1.5, times 4/9 and 1/9 under gamma = 2."""
    logit = np.log(2)
    positive = np.repeat([-logit, logit], [100, 900])
    hard, easy = np.log(3), np.log(1.5)
    base = (hard + 0.5 * easy) / (hard + 9 * easy)
    focal = (4 * hard + 0.5 * easy) / (4 * hard + 9 * easy)
    found = carried(positive, np.zeros(1000))
    assert found.hardest == pytest.approx((base, focal))
    # Both curves rise straight to 0.9 and from there: the area between them is half of what the easy ones lose.
    lost = 9 * easy / (hard + 9 * easy) - 9 * easy / (4 * hard + 9 * easy)
    assert found.moved == pytest.approx((lost / 2, 0))


def test_curves_of_negatives_lie_apart_where_the_focal_loss_moves_them() -> None:
    """The same tenth among negatives: both curves are furthest apart where the hard ones begin."""
    logit = np.log(2)
    negative = np.repeat([logit, -logit], [100, 900])
    hard, easy = np.log(3), np.log(1.5)
    base = 9 * easy / (hard + 9 * easy)
    focal = 9 * easy / (4 * hard + 9 * easy)
    found = carried(np.zeros(1000), negative)
    assert found.parted == pytest.approx(base - focal)


def test_sentences_are_judged_over_seeds() -> None:
    assert seeds(ALIKE, ALIKE, ALIKE) == [
        "ours: larger",
        "ours: no bound was printed",
        "ours: above 90%",
        "ours: larger",
        "ours: no bound was printed",
        "ours: smaller",
    ]


def test_each_interval_is_said_to_be_over_seeds_alone() -> None:
    claims = concentration_claims([ALIKE] * 3, [ALIKE] * 3)
    assert all(claim.ours.endswith("] over seeds; 3 seeds") for claim in claims)
    one = concentration_claims([ALIKE], [ALIKE])
    assert not any("over seeds" in claim.ours for claim in one)


def test_one_seed_has_no_verdict_and_none_says_nothing() -> None:
    assert seeds(ALIKE) == [f"ours: {ONE_SEED}"] * 6
    assert seeds() == [""] * 6
