"""What choosing the best of several checkpoints is worth: by hand."""

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.split_halves import (
    HALVINGS,
    best_of_k,
    best_of_k_checkpoints,
    halves,
    split_half,
)
from tests.reports.frames import tidy_scores


def test_the_best_of_k_by_hand() -> None:
    """Of 1, 2, 3: mean 2; the best of two is 2, 3 and 3; of all three 3."""
    np.testing.assert_allclose(best_of_k(np.array([3.0, 1.0, 2.0])), [2, 8 / 3, 3])


def test_a_half_chooses_and_the_other_reports() -> None:
    means = np.array(
        [[[1.0, 2.0]], [[5.0, 4.0]]]
    )  # the first side chooses checkpoint 1, the second 0
    scores = np.array([[[10.0, 20.0]], [[30.0, 40.0]]])
    assert split_half(means, scores) == ((20 + 30) / 2, (40 + 10) / 2)


@pytest.mark.parametrize("n_frames", [4, 5])
def test_every_frame_is_on_one_side_and_halvings_repeat(n_frames: int) -> None:
    sides = halves(n_frames)
    assert sides.shape == (2, HALVINGS, n_frames)
    assert (sides.sum(axis=0) == 1).all()
    assert (sides[0].sum(axis=1) == n_frames // 2).all()
    assert (sides == halves(n_frames)).all()


def test_curves_of_levels_keep_apart_and_seeds_are_averaged() -> None:
    """Of level p: 10, 20 and 15 at three steps, each 2 p higher; one seed 4 higher still."""
    scores = tidy_scores(["original", "enhanced"], groups=("VoxelNet",), seeds=(0, 1))
    scores.loc[scores["seed"] == 1, "ap_3d/moderate"] += 4.0
    found = best_of_k_checkpoints(scores)
    assert list(found.columns) == ["group", "level", "k", "best"]
    whole = pd.Series(found["best"].to_numpy(), index=[found["level"], found["k"]])
    assert whole["original"].tolist() == pytest.approx([15 + 2, (20 + 20 + 15) / 3 + 2, 20 + 2])
    assert whole["enhanced"].tolist() == pytest.approx([15 + 4, (20 + 20 + 15) / 3 + 4, 20 + 4])


def test_the_best_of_more_is_never_less_where_seeds_have_unlike_numbers_of_checkpoints() -> None:
    """Three checkpoints of seed 0 at 80, five of seed 1 at 20: the mean is 50 of one, two and three."""
    rows = [(0, step, 80.0) for step in range(3)] + [(1, step, 20.0) for step in range(5)]
    scores = pd.DataFrame(rows, columns=["seed", "step", "ap_3d/moderate"])
    found = best_of_k_checkpoints(scores.assign(group="any", level="0", first_own_step=-1))
    assert found["k"].tolist() == [1, 2, 3]
    assert found["best"].tolist() == pytest.approx([50, 50, 50])


def test_checkpoints_of_a_shared_beginning_are_no_choice() -> None:
    """10 at the first step, which all levels share; 20 and 15 of the trial's own stage."""
    scores = tidy_scores(["original"], groups=("VoxelNet",)).assign(first_own_step=10)
    assert best_of_k_checkpoints(scores)["best"].tolist() == pytest.approx([17.5, 20])
