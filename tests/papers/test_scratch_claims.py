"""Is training from scratch with the focal loss unstable? By hand arithmetic, and in words."""

import numpy as np
import pytest

from fl3d.papers.focal_loss.recorded import courses_of, is_from_scratch
from fl3d.papers.focal_loss.scratch_claims import Course, scratch_claim
from fl3d.reports.verdicts import ONE_SEED
from tests.papers.making import Made, aps, finished_sweep

STEADY = Course(np.array([1.0, 2.0, 3.0, 4.0]), np.array([4.0, 3.0, 2.0, 1.0]))


def shaky(fall: float) -> Course:
    return Course(np.array([5.0, 5.0 - fall, 9.0, 0.0]), np.array([2.0, 3.0, 1.0, 9.0]))


def test_falls_and_rises_are_of_the_first_half() -> None:
    """Of four checkpoints the first two: one fall of 2 AP, and a loss that rises by a half."""
    assert (STEADY.fall, STEADY.rise) == (0, 0)
    assert (shaky(2).fall, shaky(2).rise) == (pytest.approx(2), pytest.approx(50))


def test_the_largest_gamma_is_held_against_bce() -> None:
    courses = {
        0.0: dict.fromkeys(range(3), STEADY),
        1.0: {0: STEADY},
        2.0: {seed: shaky(2 + seed / 100) for seed in range(3)},
    }
    claim = scratch_claim("3D-FCN", courses)
    assert claim.verdict == "ours: falls larger, rises larger"
    assert claim.ours.endswith(" % over seeds; 3 seeds")
    assert claim.ours.startswith("fall 0.00 AP to 2.01, rise 0.0 % to 50.0 % (γ = 0 to 2")
    assert scratch_claim("3D-FCN", {0.0: courses[0.0], 2.0: courses[0.0]}).verdict == (
        "ours: falls not distinguishable from 0, rises not distinguishable from 0"
    )


def test_one_seed_has_no_verdict_and_none_says_nothing() -> None:
    one = scratch_claim("VoxelNet", {0.0: {0: STEADY}, 2.0: {0: shaky(2)}})
    assert one.verdict == f"ours: {ONE_SEED}"
    for courses in ({}, {0.0: {0: STEADY}}, {0.0: {0: STEADY}, 2.0: {1: STEADY}}):
        assert scratch_claim("VoxelNet", courses).ours == ""


def test_the_sweep_file_is_known_by_what_it_is() -> None:
    made = [Made(overrides=("detector=fcn3d", "loss.gamma=2"), scores={1: aps(), 2: aps()})]
    scratch = finished_sweep(("+sweep=from_scratch",), made)
    assert is_from_scratch(scratch)
    assert courses_of(scratch, "3D-FCN") == {}  # nothing was recorded
    assert not is_from_scratch(
        finished_sweep(
            ("+sweep=gamma",),
            [Made(overrides=made[0].overrides, scores={2: aps()}, first_own_step=1)],
        )
    )
    other = [Made(overrides=("loss=original",), scores={1: aps()})]
    assert not is_from_scratch(finished_sweep(("+sweep=loss_form",), other))
