"""Intervals over seeds and frames, of one number and of a family, by hand arithmetic and by simulation."""

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from fl3d.evaluation.intervals import (
    Interval,
    Sample,
    frames_alpha,
    frames_reach,
    half_width,
    interval,
    joint_intervals,
    member_alpha,
    spent_alphas,
)

Float = NDArray[np.float64]
SQUARE_3 = 3**0.5
# Two-sided 95 %, by degrees of freedom, as tables of Student's t print it.
T_95 = {1: 12.706, 2: 4.303, 4: 2.776, 9: 2.262}
PERCENTS = np.arange(101.0)  # as draws: its percentiles are themselves


def sample(
    values: list[float], low: float = 0.0, high: float = 0.0, lasting: float = 0.0
) -> Sample:
    """Seeds, and draws whose 2.5th and 97.5th percentiles are these."""
    return Sample(np.array(values), low + (PERCENTS - 2.5) / 95 * (high - low), lasting)


def of_values(values: Float) -> Sample:
    """Seeds whose frames say nothing."""
    return Sample(values, np.full(100, values.mean()))


def test_three_seeds_by_hand() -> None:
    """Values 1, 2, 3: mean 2, standard deviation 1, t of two degrees of freedom 4.303."""
    found = interval(sample([1.0, 2.0, 3.0], low=1.9, high=2.1))
    half = 4.303 / SQUARE_3
    assert found.value == 2
    assert (found.low, found.high) == pytest.approx((2 - half, 2 + half), abs=1e-3)
    assert not found.excludes_zero


@pytest.mark.parametrize("freedom", T_95)
def test_half_a_width_is_the_tabulated_t(freedom: int) -> None:
    n_seeds = freedom + 1
    assert half_width(1.0, n_seeds, 0.05) == pytest.approx(T_95[freedom] / n_seeds**0.5, rel=2e-4)
    assert half_width(3.0, n_seeds, 0.05) == pytest.approx(3 * half_width(1.0, n_seeds, 0.05))


def test_where_the_frames_reach_further_their_percentiles_are_the_interval() -> None:
    found = interval(sample([2.0, 2.0, 2.0], low=-1.5, high=4.0))
    assert (found.value, found.low, found.high) == pytest.approx((2, -1.5, 4))


def test_each_end_is_the_further_one() -> None:
    """Seeds reach 4.303 / sqrt(3) = 2.48 either way; the frames only 1 down, but 5 up."""
    found = interval(sample([1.0, 2.0, 3.0], low=1.0, high=7.0))
    assert (found.low, found.high) == pytest.approx((2 - 4.303 / SQUARE_3, 7.0), abs=1e-3)


def test_what_frames_do_to_all_seeds_is_added_in_squares() -> None:
    """Of frames that reach 4 down and 6 up a quarter of the variance lasts: 2 and 3, beside 2.48 of the seeds."""
    known = sample([1.0, 2.0, 3.0], low=-2.0, high=8.0)
    found = interval(Sample(known.values, known.draws, lasting=0.25))
    assert (found.low, found.high) == pytest.approx((-2, 8))  # the frames alone reach further
    found = interval(Sample(known.values, known.draws, lasting=1.0))
    half = 4.303 / SQUARE_3
    assert found.low == pytest.approx(2 - (4**2 + half**2) ** 0.5, abs=1e-3)
    assert found.high == pytest.approx(2 + (6**2 + half**2) ** 0.5, abs=1e-3)


def test_an_interval_over_frames_reaches_as_many_deviations_as_it_must() -> None:
    one = sample([0.5], low=0.25, high=2.0)
    spread = float(one.draws.std())
    found = interval(one, reach_frames=2.0)
    assert found.low == pytest.approx(0.5 - 2 * spread)
    assert found.high == pytest.approx(2.0)


def test_deviations_that_hold_all_members_of_most_resamples() -> None:
    """Of one normal member 1.96; of six that are independent the 0.0085 / 2 quantile, 2.631."""
    assert frames_reach(normals(1, 0.0), 0.05) == pytest.approx(1.96, rel=0.01)
    assert frames_reach(normals(6, 0.0), 0.05) == pytest.approx(2.631, rel=0.01)
    still = np.zeros((1000, 2))
    assert frames_reach(still, 0.05) == 0
    assert frames_reach(np.hstack([normals(1, 0.0, 1000), still]), 0.05) > 1.8


def test_what_the_frames_do_to_all_seeds_is_added_in_squares() -> None:
    """Seeds reach 2.484 either way; the frames 1 down and 2 up, and half of that variance lasts."""
    found = interval(sample([1.0, 2.0, 3.0], low=1.0, high=4.0, lasting=0.5))
    half = 4.3027 / SQUARE_3
    assert 2 - found.low == pytest.approx((half**2 + 0.5 * 1**2) ** 0.5, abs=1e-3)
    assert found.high - 2 == pytest.approx((half**2 + 0.5 * 2**2) ** 0.5, abs=1e-3)
    known_of_nothing = interval(sample([1.0, 2.0, 3.0], low=1.0, high=4.0, lasting=1.0))
    assert known_of_nothing.low < found.low


def test_percentiles_that_leave_the_mean_out_make_nothing_narrower() -> None:
    """A resample of few frames may be off the mean: the interval holds its value all the same."""
    found = interval(sample([2.0, 2.0, 2.0], low=2.5, high=4.0, lasting=1.0))
    assert (found.low, found.high) == pytest.approx((2.0, 4.0))
    spread = interval(sample([1.0, 2.0, 3.0], low=2.5, high=4.0, lasting=1.0))
    assert spread.low == pytest.approx(2 - 4.3027 / SQUARE_3, abs=1e-3)


def test_one_seed_has_its_frames_alone() -> None:
    one = sample([0.5], low=0.25, high=2.0)
    found = interval(one)
    assert (found.value, found.low, found.high) == pytest.approx((0.5, 0.25, 2.0))
    assert np.isnan(one.spread)
    assert found.excludes_zero


def test_frames_and_seeds_have_an_error_each() -> None:
    two = Sample(np.array([40.0, 50.0, 60.0]), PERCENTS, lasting=0.0)
    wide = interval(two, alpha=0.05, alpha_frames=0.02)
    assert wide.low == pytest.approx(min(1.0, 50 - 4.303 * 10 / SQUARE_3), abs=1e-2)
    narrow = interval(two, alpha=0.5, alpha_frames=0.02)
    assert (narrow.low, narrow.high) == pytest.approx((1.0, 99.0))


def test_an_interval_knows_zero_and_a_margin() -> None:
    assert Interval(1.0, 0.1, 2.0).excludes_zero
    assert Interval(-1.0, -2.0, -0.1).excludes_zero
    assert not Interval(1.0, 0.0, 2.0).excludes_zero
    assert Interval(0.1, -0.9, 0.9).is_within(1)
    assert not Interval(0.1, -0.9, 1.0).is_within(1)
    assert not Interval(0.1, -1.0, 0.9).is_within(1)


def test_an_interval_of_a_percentage_ends_at_0_and_100_and_stays_unknown_where_it_is() -> None:
    assert Interval(1.0, -2.0, 4.0).within_percent() == Interval(1.0, 0.0, 4.0)
    assert Interval(99.0, 97.0, 101.0).within_percent() == Interval(99.0, 97.0, 100.0)
    nothing = Interval(np.nan, np.nan, np.nan).within_percent()
    assert np.isnan([nothing.value, nothing.low, nothing.high]).all()


def normals(n_members: int, shared: float, n_draws: int = 100_000, seed: int = 0) -> Float:
    """Members with unequal spreads and a part in common: (R, L)."""
    rng = np.random.default_rng(seed)
    own = rng.standard_normal((n_draws, n_members))
    common = rng.standard_normal((n_draws, 1))
    return (shared**0.5 * common + (1 - shared) ** 0.5 * own) * np.arange(1, n_members + 1)


def test_of_one_member_the_frames_error_is_the_familys() -> None:
    assert frames_alpha(normals(1, 0.0), 0.05) == pytest.approx(0.05, rel=1e-3)
    assert frames_alpha(normals(1, 0.0, 1000), 0.05) == pytest.approx(0.05, abs=2e-3)


def test_members_that_are_the_same_share_nothing_out() -> None:
    one = normals(1, 0.0)
    assert frames_alpha(np.repeat(one, 6, axis=1), 0.05) == pytest.approx(0.05, rel=1e-3)
    assert frames_alpha(np.hstack([one, 3 * one + 1, -one]), 0.05) == pytest.approx(0.05, rel=1e-3)


def test_independent_members_share_the_error_out() -> None:
    """Six: 1 - 0.95^(1/6) = 0.0085 each."""
    assert frames_alpha(normals(6, 0.0), 0.05) == pytest.approx(1 - 0.95 ** (1 / 6), rel=0.06)


@pytest.mark.parametrize("shared", [0.0, 0.5, 0.95])
def test_as_many_resamples_as_asked_for_lie_within_all_members_percentiles(shared: float) -> None:
    draws = normals(6, shared)
    error = frames_alpha(draws, 0.05)
    low, high = np.percentile(draws, [50 * error, 100 - 50 * error], axis=0)
    outside = ((draws < low) | (draws > high)).any(axis=1)
    assert outside.mean() == pytest.approx(0.05, rel=0.03)


def test_a_resample_is_as_rare_as_the_values_beyond_it_are_also_where_many_are_equal() -> None:
    """Counted one by one, as the error of a family is defined."""
    rng = np.random.default_rng(0)
    whole = rng.poisson(0.4, (300, 12)).astype(float)  # zeros, and few values beyond
    few = np.round(rng.normal(size=(300, 5)), 1)
    for draws in (whole, few, np.hstack([whole, few])):
        rarest = np.ones(len(draws))
        for column in draws.T:
            below = (column[None, :] <= column[:, None]).sum(1) / len(column)
            above = 1 - (column[None, :] < column[:, None]).sum(1) / len(column)
            rarest = np.minimum(rarest, 2 * np.minimum(below, above))
        for alpha in (0.05, 0.3, 0.7):
            expected = max(alpha / draws.shape[1], min(alpha, float(np.quantile(rarest, alpha))))
            assert frames_alpha(draws, alpha) == expected
    assert frames_alpha(whole, 0.3) < 0.3  # neither end decides
    assert frames_alpha(whole, 0.3) > 0.3 / 12


def test_members_that_do_not_move_cost_nothing() -> None:
    one = normals(1, 0.0)
    assert frames_alpha(np.hstack([one, np.zeros_like(one)]), 0.05) == pytest.approx(0.05, rel=1e-3)


def test_an_interval_of_a_family_is_never_narrower_than_alone() -> None:
    draws = normals(6, 0.5, 2000)
    family = [Sample(np.array([-1.0, 0.5, 1.5]) * n, column) for n, column in enumerate(draws.T, 1)]
    for together, one in zip(joint_intervals(family), map(interval, family), strict=True):
        assert together.value == one.value
        assert together.low < one.low
        assert together.high > one.high


def test_a_family_of_none_and_of_one() -> None:
    assert joint_intervals([]) == []
    one = sample([1.0, 2.0, 3.0], low=1.5, high=2.5)
    assert joint_intervals([one])[0] == interval(one, 0.05, frames_alpha(one.draws[:, None], 0.05))


def test_members_of_which_nothing_is_known_take_nothing_from_the_others() -> None:
    one, nothing = of_values(np.array([1.0, 2.0, 3.0])), of_values(np.full(3, np.nan))
    alone = joint_intervals([one])[0]
    unknown, known = joint_intervals([nothing, one])
    assert known == alone
    assert np.isnan([unknown.value, unknown.low, unknown.high]).all()
    assert np.isnan(joint_intervals([nothing])[0].value)


def test_members_with_fewer_seeds_have_the_t_of_their_own() -> None:
    draws = np.zeros(100)
    values = np.array([-1.0, 0.0, 1.0, -1.0, 1.0])
    three, five = joint_intervals([Sample(values[:3], draws), Sample(values, draws)])
    error = 1 - 0.95**0.5
    assert three.high == pytest.approx(stats.t.ppf(1 - error / 2, 2) / 3**0.5)
    assert five.high == pytest.approx(stats.t.ppf(1 - error / 2, 4) / 5**0.5)


def test_a_members_error_is_its_share_of_the_familys() -> None:
    assert member_alpha(1, 5) == pytest.approx(0.05)
    assert member_alpha(6, 5) == pytest.approx(1 - 0.95 ** (1 / 6))
    assert member_alpha(6, 5, looks=(5,)) == member_alpha(6, 5)
    assert 1 - (1 - member_alpha(36, 3, alpha=0.2)) ** 36 == pytest.approx(0.2)


def test_with_several_looks_the_error_is_that_of_the_last_look_that_was_reached() -> None:
    looks = (3, 5, 8)
    spent = spent_alphas(member_alpha(2, 3), looks)
    assert [member_alpha(2, n, looks) for n in (2, 3, 4, 5, 7, 8, 9)] == [
        spent[place] for place in (0, 0, 0, 1, 1, 2, 2)
    ]


@pytest.mark.parametrize("looks", [(3, 4, 5, 6), (2, 4, 8), (3, 10), (3, 15, 30)])
@pytest.mark.parametrize("alpha", [0.05, 0.0085])
def test_misses_over_all_looks_add_up_to_the_error(alpha: float, looks: tuple[int, ...]) -> None:
    """By other sequences, with a mean and a spread of their own, and SciPy's t test."""
    n = 200_000
    values = np.random.default_rng(7).normal(3.0, 2.0, (n, looks[-1]))
    missed = np.zeros(n, dtype=bool)
    for look, error in zip(looks, spent_alphas(alpha, looks), strict=True):
        missed |= stats.ttest_1samp(values[:, :look], 3.0, axis=1).pvalue <= error
        spent = alpha * (look / looks[-1]) ** 2
        # Both simulations are uncertain: 400,000 sequences there, 200,000 here.
        assert missed.mean() == pytest.approx(spent, abs=4 * (spent / n * 1.5) ** 0.5)


@pytest.mark.parametrize("looks", [(3, 4, 5, 6, 7, 8), (3, 5, 10)])
def test_errors_rise_from_look_to_look_and_stay_below_that_of_one_look(
    looks: tuple[int, ...],
) -> None:
    spent = spent_alphas(0.05, looks)
    assert list(spent) == sorted(spent)
    assert 0 < spent[0] < spent[-1] < 0.05
    half = spent_alphas(0.025, looks)
    assert all(small < large for small, large in zip(half, spent, strict=True))


def test_one_look_spends_all_at_once() -> None:
    assert spent_alphas(0.05, (5,)) == pytest.approx((0.05,), rel=0.03)


def test_the_errors_of_many_looks_take_no_more_memory_than_those_of_few() -> None:
    """Sums and squares of 400,000 sequences are 6.4 MB, and so it stays; all values of a hundred seeds are 320 MB."""
    spent_alphas.cache_clear()
    tracemalloc.start()
    try:
        spent = spent_alphas(0.05, tuple(range(3, 101)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100e6
    assert 0 < spent[0] < spent[-1] < 0.05


def test_looking_after_every_seed_without_spending_would_miss_too_often() -> None:
    """What the looks are for: at 5 % each, looks at 3 to 8 seeds miss in more than a tenth of sequences."""
    values = np.random.default_rng(8).standard_normal((20_000, 8))
    found = [stats.ttest_1samp(values[:, :n], 0.0, axis=1).pvalue < 0.05 for n in range(3, 9)]
    assert np.any(found, axis=0).mean() > 0.1


@pytest.mark.parametrize("n_seeds", [2, 3, 5])
def test_an_interval_of_seeds_holds_the_truth_as_often_as_it_says(n_seeds: int) -> None:
    """4000 draws of seeds around 7: the share is known to 0.3 %."""
    values = np.random.default_rng(9).normal(7.0, 3.0, (4000, n_seeds))
    found = [interval(of_values(own)) for own in values]
    held = np.mean([one.low <= 7 <= one.high for one in found])
    assert held == pytest.approx(0.95, abs=0.012)


def test_intervals_of_a_family_hold_all_at_once() -> None:
    """Six gains over one baseline, three seeds: what the levels share is the baseline's own noise."""
    rng = np.random.default_rng(10)
    held = []
    for _ in range(2000):
        base = rng.normal(0, 3, 3)
        family = [of_values(rng.normal(0, 3, 3) - base) for _ in range(6)]
        held.append(all(one.low <= 0 <= one.high for one in joint_intervals(family)))
    assert 0.94 < np.mean(held) < 0.99
