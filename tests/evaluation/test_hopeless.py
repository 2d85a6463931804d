"""When more seeds surely bring no verdict, and what of the frames' part they take away."""

import numpy as np
import pytest

from fl3d.evaluation.intervals import Sample, half_width, lasting_share
from fl3d.evaluation.verdicts import Known, is_hopeless, seeds_needed

MARGIN = 1.0


def known(gain: float, frames: float, spread: float = 0.1, lasting: float = 1.0) -> Known:
    """Of four seeds, with an interval over frames that reaches as far below as above."""
    return Known(gain, spread, frames, frames, n_seeds=4, lasting=lasting)


def test_frames_that_are_too_few_for_any_verdict_are_hopeless() -> None:
    """Seeds know the mean to 0.16 AP (t of three degrees of freedom, 3.18 by 0.1 / 2); frames reach 1.5 AP."""
    assert half_width(0.1, 4, 0.05) == pytest.approx(3.1824 * 0.05, abs=1e-4)
    assert is_hopeless(known(0.5, frames=1.5), MARGIN, 10)
    assert is_hopeless(known(-0.5, frames=1.5), MARGIN, 10)


def test_hope_is_left_where_the_mean_may_still_come_to_a_verdict() -> None:
    assert not is_hopeless(known(1.4, frames=1.5), MARGIN, 10)  # 1.56 would be told from 0
    assert is_hopeless(known(1.3, frames=1.5), MARGIN, 10)
    assert not is_hopeless(known(-1.4, frames=1.5), MARGIN, 10)
    assert not is_hopeless(known(0.3, frames=0.8), MARGIN, 10)  # 0.2 would lie within the margin
    assert is_hopeless(known(0.4, frames=0.8), MARGIN, 10)
    assert not is_hopeless(known(0.5, frames=1.5, spread=2.0), MARGIN, 10)  # the mean may be 3


def test_seeds_that_gained_the_same_to_the_digit_leave_hope_as_any_others_do() -> None:
    """The mean stays 0; frames that reach 1.1 AP with four seeds reach 1.1 by the root of 4 / 10, 0.7, with ten."""
    same = known(0.0, frames=1.1, spread=0.0, lasting=0.0)
    assert seeds_needed(same, MARGIN, 0.05) == 5  # 1.1 by the root of 4 / 5 is 0.98
    assert not is_hopeless(same, MARGIN, 10)
    assert not is_hopeless(known(0.0, frames=1.1, spread=1e-9, lasting=0.0), MARGIN, 10)
    assert is_hopeless(known(0.0, frames=1.1, spread=0.0), MARGIN, 10)  # all of it lasts


def test_frames_part_that_averages_out_leaves_hope_for_as_many_seeds_as_may_come() -> None:
    """Nothing of it lasts: from 4 to 16 seeds 1.5 AP become 0.75."""
    passing = known(0.0, frames=1.5, lasting=0.0)
    assert passing.reach(16) == pytest.approx((0.75, 0.75))
    assert is_hopeless(passing, MARGIN, 7)  # 1.5 by the root of 4 / 7: 1.13
    assert not is_hopeless(passing, MARGIN, 16)
    half = known(0.0, frames=1.5, lasting=0.5)
    assert half.reach(16) == pytest.approx([1.5 * (0.5 + 0.5 / 4) ** 0.5] * 2)


def test_nothing_is_given_up_before_a_verdict_is_possible() -> None:
    assert not is_hopeless(Known(0.0, 0.1, 5.0, 5.0, n_seeds=2), MARGIN, 10)


def test_seeds_that_are_needed_count_what_they_take_from_the_frames() -> None:
    """Of a gain of 1 AP, frames that reach 1.5 AP with four seeds reach less than 1 with ten."""
    passing = known(1.0, frames=1.5, lasting=0.0)
    assert seeds_needed(passing, MARGIN, 0.05) == 10  # 1.5 by the root of 4 / 9 is 1: not yet
    assert seeds_needed(known(1.0, frames=1.5), MARGIN, 0.05) is None


def test_what_is_the_same_for_all_seeds_lasts_and_the_rest_does_not() -> None:
    rng = np.random.default_rng(0)
    own = rng.standard_normal((5, 20_000))
    common = rng.standard_normal(20_000)
    assert lasting_share(np.stack([common] * 3)) == pytest.approx(1)
    assert lasting_share(own) == pytest.approx(0, abs=0.02)
    # Of a mean of five: variance 1 that lasts, and 2 / 5 that does not.
    assert lasting_share(common + np.sqrt(2) * own) == pytest.approx(1 / 1.4, abs=0.02)


def test_of_one_seed_all_lasts_and_where_nothing_moves_nothing() -> None:
    assert lasting_share(np.ones((1, 9))) == 1
    assert lasting_share(np.zeros((3, 9))) == 0
    assert Sample(np.zeros(1), np.zeros(9)).lasting == 0  # unknown
