"""How sure a mean over training seeds is: intervals over seeds and frames, of one number or of a family at once.

Over frames: percentiles of the resampled mean. Over seeds: Student's t of the seeds' own values, which hold what
training does by chance, and what frames do to each seed by itself. What frames do to all seeds alike is in no
difference between seeds: where it is known, its part of the interval over frames is added, as independent errors add
(in squares). The wider of the two alone is too narrow where both matter (``benchmarks/verdicts.py``, last column);
``benchmarks/interval_coverage.py`` measures how often an interval holds the truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

Float = NDArray[np.float64]
ALPHA = 0.05  # an interval may miss the truth so often
SIMULATED = (
    400_000  # sequences of seeds: of a family of six, 3400 miss, so that share is known to 2 %
)
AT_ONCE = 20  # seeds whose values are held together: 64 MB
SPENDING = 2  # with 1 the last interval is a tenth wider, with 3 clear gains take longer: benchmarks/verdicts.py


@dataclass(frozen=True)
class Interval:
    """Where a mean lies.

    Args:
        value: the mean over seeds, on the frames as they are.
        low: lower end.
        high: upper end.
    """

    value: float
    low: float
    high: float

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of zero."""
        return self.low > 0 or self.high < 0

    def within_percent(self) -> Interval:
        """The same of a number that lies in 0..100, as an AP does: t knows nothing of these ends. NaN stays NaN."""
        low, high = np.maximum(0.0, self.low), np.minimum(100.0, self.high)  # max() takes 0 for NaN
        return Interval(self.value, float(low), float(high))

    def is_within(self, margin: float) -> bool:
        """Whether all of it lies less than a margin from zero."""
        return -margin < self.low and self.high < margin


NO_INTERVAL = Interval(np.nan, np.nan, np.nan)  # of a number that is not known


@dataclass(frozen=True)
class Sample:
    """What is known of a number that training seeds were asked for.

    Args:
        values: (S,) of each seed, on the frames as they are.
        draws: (R,) the mean over these seeds in each resample of the frames.
        lasting: share of the draws' variance that is the same for all seeds, see ``lasting_share``; 0: none is known.
        copies: seeds whose detections are the same, of the number or of what it is a gain over: they are one run of
            training under several seeds, and are counted once; from such seeds comes no verdict.
    """

    values: Float
    draws: Float
    lasting: float = 0.0
    copies: tuple[int, ...] = ()

    @property
    def spread(self) -> float:
        """Standard deviation between seeds; NaN of one seed."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")


def lasting_share(draws: Float) -> float:
    """Share of the variance over frames of a mean over seeds that is the same for all seeds, 0 to 1.

    What frames do to each seed by itself averages out as seeds are added; what they do to all seeds does not.

    Args:
        draws: (S, R) of each seed in the same resamples.
    """
    n_seeds = len(draws)
    of_mean = float(np.var(draws.mean(axis=0)))
    if n_seeds < 2:
        return 1.0
    if of_mean == 0:
        return 0.0
    own = (float(np.var(draws, axis=1).mean()) - of_mean) / (n_seeds - 1)  # of the mean
    return min(1.0, max(0.0, 1 - own / of_mean))


def interval(
    sample: Sample,
    alpha: float = ALPHA,
    alpha_frames: float | None = None,
    reach_frames: float = 0.0,
) -> Interval:
    """The interval of a mean over seeds; of one seed over frames alone.

    Args:
        sample: the number.
        alpha: how often the interval over seeds may miss.
        alpha_frames: the same over frames; None: ``alpha``.
        reach_frames: how far the interval over frames reaches at least, in standard deviations of the draws.
    """
    value = float(np.mean(sample.values))
    tail = 50 * (alpha if alpha_frames is None else alpha_frames)
    low, high = (float(end) for end in np.percentile(sample.draws, [tail, 100 - tail]))
    reach = reach_frames * float(np.std(sample.draws))
    below, above = max(value - low, reach), max(high - value, reach)
    n_seeds = len(sample.values)
    if n_seeds > 1:
        half = half_width(sample.spread, n_seeds, alpha)
        below = max(below, added(below, sample.lasting, half))
        above = max(above, added(above, sample.lasting, half))
    return Interval(value, value - below, value + above)


def added(frames: float, lasting: float, seeds: float) -> float:
    """What the lasting part of an interval over frames and one over seeds reach together."""
    return float(np.hypot(np.sqrt(lasting) * max(frames, 0.0), seeds))


def half_width(spread: float, n_seeds: int, alpha: float) -> float:
    """Half of a t interval of a mean over so many seeds."""
    return float(stdtrit(n_seeds - 1, 1 - alpha / 2)) * spread / float(np.sqrt(n_seeds))


def joint_intervals(
    family: Sequence[Sample], alpha: float = ALPHA, looks: tuple[int, ...] = ()
) -> list[Interval]:
    """Intervals that hold all at once: that any of them misses is as rare as ``alpha``.

    Over frames the percentiles are widened alike until so many resamples lie within all of them (the members share
    their resamples), and reach at least as many standard deviations as hold so many resamples: far out, percentiles
    of gains between detectors that are much alike are too narrow (9.7 % of 300 families of six missed; by standard
    deviations 5.0 %). Over seeds the error is shared out (Šidák), which holds whatever the members have in common.

    Args:
        family: its members. Those that are not known (NaN) have no interval, and no share of the error.
        alpha: of the family.
        looks: see ``member_alpha``.
    """
    known = [one for one in family if not np.isnan(one.values).any()]
    if not known:
        return [NO_INTERVAL] * len(family)
    draws = np.stack([one.draws for one in known], axis=1)
    frames, reach = frames_alpha(draws, alpha), frames_reach(draws, alpha)

    def of(one: Sample) -> Interval:
        error = member_alpha(len(known), len(one.values), looks, alpha)
        return interval(one, error, frames, reach)

    return [NO_INTERVAL if np.isnan(one.values).any() else of(one) for one in family]


def member_alpha(
    n_members: int, n_seeds: int, looks: tuple[int, ...] = (), alpha: float = ALPHA
) -> float:
    """Error of one member's t interval at one look.

    Args:
        n_members: of the family.
        n_seeds: now.
        looks: numbers of seeds after which intervals are looked at, where seeds are added until a verdict
            comes: the error is spent over these looks. Empty: they are looked at once.
        alpha: of the family.
    """
    own = 1 - (1 - alpha) ** (1 / n_members)
    if len(looks) < 2:
        return own
    place = sum(look <= n_seeds for look in looks)
    return spent_alphas(own, looks)[max(place, 1) - 1]


def frames_alpha(draws: Float, alpha: float) -> float:
    """Two-sided error of each member's percentiles, such that a resample lies outside any as rarely as ``alpha``.

    Args:
        draws: (R, L) of the members, under common weights.
        alpha: of the family.
    """
    n_draws, n_members = draws.shape
    rarest = np.ones(n_draws)
    for column in draws.T:
        order = np.argsort(column)
        first, end = _equal_neighbours(column[order])
        two_sided = 2 * np.minimum(end / n_draws, 1 - first / n_draws)
        rarest[order] = np.minimum(rarest[order], two_sided)
    return max(alpha / n_members, min(alpha, float(np.quantile(rarest, alpha))))


def _equal_neighbours(ordered: Float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the run of equal values begins that each value is of, and behind its end: (R,) each.

    What ``searchsorted`` finds of every value from the left and the right, in an eighth of its time.

    Args:
        ordered: (R,) rising; NaNs stand last, and are equal.
    """
    changes = (ordered[1:] != ordered[:-1]) & ~np.isnan(ordered[:-1])
    bounds = np.flatnonzero(np.concatenate([[True], changes, [True]]))
    lengths = np.diff(bounds)
    return np.repeat(bounds[:-1], lengths), np.repeat(bounds[1:], lengths)


def frames_reach(draws: Float, alpha: float) -> float:
    """Standard deviations from its mean within which every member of a resample lies, but for ``alpha`` of them.

    Args:
        draws: (R, L) of the members, under common weights.
        alpha: of the family.
    """
    spread = draws.std(axis=0)
    moving = spread > 0
    if not moving.any():
        return 0.0
    scaled = np.abs(draws[:, moving] - draws[:, moving].mean(axis=0)) / spread[moving]
    return float(np.quantile(scaled.max(axis=1), 1 - alpha))


@lru_cache(maxsize=64)
def spent_alphas(alpha: float, looks: tuple[int, ...]) -> tuple[float, ...]:
    """Two-sided error of a t interval at each look, such that it misses at any of them as rarely as ``alpha``.

    By look n of the last N, alpha (n / N)^2 is spent (Kim and DeMets 1987): early looks, where t is wide anyhow, cost
    little, and the last is nearly as sharp as one alone. A t statistic of normal values depends on neither their mean
    nor their spread, so the errors are simulated once, by a fixed seed.

    Args:
        alpha: over all looks.
        looks: numbers of seeds, rising, the first at least 2.
    """
    sums, squares = np.zeros(SIMULATED), np.zeros(SIMULATED)
    is_out = np.zeros(SIMULATED, dtype=bool)  # at any look so far
    found = []
    for n, values in enumerate(_simulated(looks[-1]), 1):
        sums += values
        squares += values**2
        if n not in looks:
            continue
        share = sums**2 / (n * squares)  # of the squares that is the mean's: t rises with it
        share[is_out] = -1.0
        spent = alpha * (n / looks[-1]) ** SPENDING
        n_out = max(1, round(spent * SIMULATED) - int(is_out.sum()))
        first = float(np.partition(share, -n_out)[-n_out])
        found.append(2 * float(stdtr(n - 1, -np.sqrt((n - 1) * first / (1 - first)))))
        is_out |= share >= first
    return tuple(found)


def _simulated(n_seeds: int) -> Iterator[Float]:
    """Normal values of one seed after another: (``SIMULATED``,) each.

    Few seeds are drawn at once, sequence by sequence, which published intervals come from; of many that would take
    gigabytes.
    """
    rng = np.random.default_rng(0)
    if n_seeds <= AT_ONCE:
        yield from rng.standard_normal((SIMULATED, n_seeds)).T
        return
    for _ in range(n_seeds):
        yield rng.standard_normal(SIMULATED)
