"""Words by hand-made intervals, and how many seeds would say more."""

import math

import numpy as np
import pytest
from scipy import stats

from fl3d.evaluation.intervals import Interval, Sample, half_width, interval
from fl3d.evaluation.verdicts import (
    FEWEST,
    MOST,
    POWER,
    Known,
    Verdict,
    seeds_for,
    seeds_needed,
    smallest_gain,
    verdict_of,
)


@pytest.mark.parametrize(
    ("low", "value", "high", "word"),
    [
        (0.5, 2.0, 3.5, Verdict.BETTER),
        (-3.5, -2.0, -0.5, Verdict.WORSE),
        (-0.9, 0.1, 0.9, Verdict.EQUIVALENT),
        (-0.2, 0.1, 1.2, Verdict.UNDECIDED),
        (-1.2, -0.1, 0.2, Verdict.UNDECIDED),
        (-4.0, 0.5, 5.0, Verdict.UNDECIDED),
        (0.0, 0.0, 0.0, Verdict.EQUIVALENT),  # the same detections, seed by seed
        (0.0, 0.5, 0.8, Verdict.EQUIVALENT),  # an end on zero does not exclude it
        (-0.5, 0.2, 1.0, Verdict.UNDECIDED),  # and one on the margin does not lie within
    ],
)
def test_words(low: float, value: float, high: float, word: Verdict) -> None:
    assert verdict_of(Interval(value, low, high), 3, margin=1.0) is word


def test_surely_better_by_a_little_is_better_and_not_equivalent() -> None:
    assert verdict_of(Interval(0.4, 0.1, 0.7), 3, margin=1.0) is Verdict.BETTER
    assert verdict_of(Interval(-0.4, -0.7, -0.1), 3, margin=1.0) is Verdict.WORSE


def test_a_wider_margin_makes_more_equivalent() -> None:
    gain = Interval(0.5, -1.5, 2.5)
    assert verdict_of(gain, 5, margin=1.0) is Verdict.UNDECIDED
    assert verdict_of(gain, 5, margin=3.0) is Verdict.EQUIVALENT


@pytest.mark.parametrize("n_seeds", [1, 2])
def test_one_and_two_seeds_have_no_verdict_however_clear_the_gain(n_seeds: int) -> None:
    assert verdict_of(Interval(9.0, 8.0, 10.0), n_seeds, margin=1.0) is Verdict.NONE
    assert verdict_of(Interval(9.0, 8.0, 10.0), FEWEST, margin=1.0) is Verdict.BETTER


def test_what_ends_the_search_for_more_seeds() -> None:
    final = {verdict for verdict in Verdict if verdict.is_final}
    assert final == {Verdict.BETTER, Verdict.WORSE, Verdict.EQUIVALENT}


def test_seeds_that_would_tell_a_gain_by_hand() -> None:
    """Gain 2, spread 1: at 3 seeds half the interval is 4.303 / sqrt 3 = 2.48, at 4 it is 3.182 / 2 = 1.59."""
    assert seeds_needed(Known(2.0, 1.0), margin=1.0, alpha=0.05) == 4
    assert seeds_needed(Known(-2.0, 1.0), margin=1.0, alpha=0.05) == 4
    assert seeds_needed(Known(2.6, 1.0), margin=1.0, alpha=0.05) == 3


def test_seeds_that_would_tell_equivalence_by_hand() -> None:
    """Gain 0, spread 1, margin 1: half is 2.571 / sqrt 6 = 1.05, then 2.447 / sqrt 7 = 0.92."""
    assert seeds_needed(Known(0.0, 1.0), margin=1.0, alpha=0.05) == 7
    assert seeds_needed(Known(0.0, 1.0), margin=1.0, alpha=0.05, fewest=9) == 9


def test_frames_that_reach_over_zero_and_margin_are_no_matter_of_seeds() -> None:
    assert seeds_needed(Known(2.0, 1.0, below=3.0, above=0.5), margin=1.0, alpha=0.05) is None
    assert seeds_needed(Known(0.0, 1.0, below=0.1, above=1.1), margin=1.0, alpha=0.05) is None
    assert seeds_needed(Known(0.0, 1.0, below=0.1, above=0.3), margin=1.0, alpha=0.05) == 7


def test_frames_that_nearly_fill_the_margin_leave_the_seeds_little_of_it() -> None:
    """0.9 and the seeds' part lie within 1 where that is below 0.436.

    2.080 / sqrt 22 is 0.443, and 2.074 / sqrt 23 is 0.432.
    """
    assert seeds_needed(Known(0.0, 1.0, below=0.1, above=0.9), margin=1.0, alpha=0.05) == 23


def test_of_an_unknown_spread_nothing_is_foretold() -> None:
    assert seeds_needed(Known(2.0, math.nan), margin=1.0, alpha=0.05) is None


def test_what_is_foretold_is_the_interval_of_such_seeds() -> None:
    known = Known(gain=2.0, spread=1.5, below=1.0, above=4.0)
    found = known.interval(4, 0.05)
    assert found.value == 2.0
    half = half_width(1.5, 4, 0.05)
    assert found.low == pytest.approx(2.0 - math.hypot(half, 1.0))
    assert found.high == pytest.approx(2.0 + math.hypot(half, 4.0))


def test_of_the_frames_part_more_seeds_take_away_what_does_not_last() -> None:
    """Of 1 AP with two seeds half the variance passes: with eight seeds 1/2 + 1/8 of it is left, 1/2 beside t."""
    known = Known(gain=0.0, spread=0.1, below=1.0, above=1.0, n_seeds=2, lasting=0.5)
    half = half_width(0.1, 8, 0.05)
    assert known.interval(8, 0.05).high == pytest.approx(0.625**0.5)
    assert half < 0.125**0.5
    wide = Known(gain=0.0, spread=1.0, below=1.0, above=1.0, n_seeds=2, lasting=0.5)
    expected = math.hypot(half_width(1.0, 8, 0.05), 0.5**0.5)
    assert wide.interval(8, 0.05).high == pytest.approx(expected)
    passing = Known(gain=0.0, spread=1.0, below=1.0, above=1.0, n_seeds=2, lasting=0.0)
    assert passing.interval(8, 0.05).high == pytest.approx(half_width(1.0, 8, 0.05))


def test_what_is_foretold_of_as_many_seeds_is_the_interval_that_they_have() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(1.0, 0.4, 5)
    draws = values.mean() + rng.normal(0, 0.3, 5000)
    sample = Sample(values, draws, lasting=0.6)
    frames = np.percentile(draws, [2.5, 97.5]) - values.mean()
    known = Known(float(values.mean()), sample.spread, -frames[0], frames[1], 5, 0.6)
    found, foretold = interval(sample), known.interval(5, 0.05)
    assert (foretold.low, foretold.high) == pytest.approx((found.low, found.high))


@pytest.mark.parametrize("alpha", [0.05, 0.0085])
@pytest.mark.parametrize("n_seeds", [2, 3, 5, 10, 40])
def test_the_smallest_gain_is_told_four_times_in_five(n_seeds: int, alpha: float) -> None:
    """By SciPy's noncentral t, whose noncentrality is the gain in standard errors."""
    gain = smallest_gain(1.7, n_seeds, alpha)
    critical = stats.t.ppf(1 - alpha / 2, n_seeds - 1)
    told = stats.nct.sf(critical, n_seeds - 1, gain / (1.7 / n_seeds**0.5))
    assert told == pytest.approx(POWER, abs=1e-3)


@pytest.mark.parametrize("n_seeds", [3, 6])
def test_the_smallest_gain_by_simulation(n_seeds: int) -> None:
    gain = smallest_gain(2.0, n_seeds, 0.05)
    values = np.random.default_rng(1).normal(gain, 2.0, (20_000, n_seeds))
    low = values.mean(axis=1) - half_width(1.0, n_seeds, 0.05) * values.std(axis=1, ddof=1)
    assert (low > 0).mean() == pytest.approx(POWER, abs=0.012)


@pytest.mark.parametrize("lasting", [0.2, 1.0, 4.0])
def test_the_smallest_gain_with_what_the_frames_do_to_all_seeds(lasting: float) -> None:
    """By intervals of five seeds: s.d. 1 each, and an s.d. that they share, which the frames' interval knows."""
    frames = 1.96 * lasting
    gain = smallest_gain(1.0, 5, 0.05, frames)
    rng = np.random.default_rng(2)
    values = rng.normal(gain, 1.0, (20_000, 5)) + rng.normal(0, lasting, (20_000, 1))
    half = np.hypot(half_width(1.0, 5, 0.05) * values.std(axis=1, ddof=1), frames)
    assert (values.mean(axis=1) > half).mean() == pytest.approx(POWER, abs=0.03)


def test_more_seeds_tell_smaller_gains_but_none_below_the_frames() -> None:
    gains = [smallest_gain(1.0, n, 0.05) for n in (3, 5, 10, 20)]
    assert gains == sorted(gains, reverse=True)
    # 0.842 and 1.960 are the normal's quantiles of 80 % and 97.5 %.
    floor = 1.5 * (1 + 0.842 / 1.960)
    assert smallest_gain(0.0, 3, 0.05, frames=1.5) == pytest.approx(floor, rel=1e-3)
    assert smallest_gain(1.0, 1000, 0.05, frames=1.5) == pytest.approx(floor, rel=1e-2)
    assert smallest_gain(1.0, 20, 0.05, frames=1.5) > floor


def test_seeds_for_a_margin_are_the_fewest_that_tell_it() -> None:
    needed = seeds_for(1.0, spread=1.0, alpha=0.05)
    assert needed is not None
    assert smallest_gain(1.0, needed, 0.05) <= 1.0 < smallest_gain(1.0, needed - 1, 0.05)
    assert seeds_for(9.0, spread=1.0, alpha=0.05) == FEWEST
    assert seeds_for(1.0, spread=1.0, alpha=0.05, frames=1.1) is None
    assert seeds_for(0.01, spread=MOST, alpha=0.05) is None
