"""Better, worse, equivalent or undecided: what an interval of a gain says, and how many seeds would say more."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import nctdtr, ndtri, stdtrit

from fl3d.evaluation.intervals import ALPHA, Interval, added, half_width

FEWEST = 3  # seeds of a verdict: of one there is no spread, and t of two is 12.7 spreads wide
MOST = 1000  # seeds that are thought of
POWER = 0.8  # chance to tell a gain that is called one that can be told


class Verdict(StrEnum):
    """What is said of a level, by the primary metric."""

    BETTER = "better"
    WORSE = "worse"
    EQUIVALENT = "equivalent"
    UNDECIDED = "undecided"
    BASELINE = "baseline"
    NONE = "none"  # fewer seeds than a verdict needs

    @property
    def is_final(self) -> bool:
        """Whether more seeds are not asked for."""
        return self in (Verdict.BETTER, Verdict.WORSE, Verdict.EQUIVALENT)


def verdict_of(gain: Interval, n_seeds: int, margin: float) -> Verdict:
    """The verdict on a gain.

    Args:
        gain: its interval, simultaneous over the levels of its group.
        n_seeds: that it is the mean of.
        margin: gains below it do not matter, AP.
    """
    if n_seeds < FEWEST:
        return Verdict.NONE
    if gain.excludes_zero:
        return Verdict.BETTER if gain.value > 0 else Verdict.WORSE
    return Verdict.EQUIVALENT if gain.is_within(margin) else Verdict.UNDECIDED


@dataclass(frozen=True)
class Known:
    """What is known of a gain before there are more seeds.

    Args:
        gain: mean over the seeds so far, or what it is taken to be.
        spread: its standard deviation between seeds.
        below: how far the interval over frames reaches below the mean.
        above: likewise above it.
        n_seeds: of the interval over frames.
        lasting: share of its variance that more seeds do not take away, see ``intervals.lasting_share``.
    """

    gain: float
    spread: float
    below: float = 0.0
    above: float = 0.0
    n_seeds: int = 1
    lasting: float = 1.0

    def interval(self, n_seeds: int, alpha: float) -> Interval:
        """What is to be expected of so many seeds."""
        half = half_width(self.spread, n_seeds, alpha)
        below, above = self.reach(n_seeds)
        low = self.gain - max(below, added(self.below, self.lasting, half))
        return Interval(
            self.gain, low, self.gain + max(above, added(self.above, self.lasting, half))
        )

    def reach(self, n_seeds: int) -> tuple[float, float]:
        """How far the interval over frames will reach below and above the mean of so many seeds."""
        narrowed = left_of_frames(self.lasting, self.n_seeds, n_seeds)
        return self.below * narrowed, self.above * narrowed


def left_of_frames(lasting: float, known: int, n_seeds: float) -> float:
    """What part of an interval over frames is left with another number of seeds: what does not last averages out.

    Args:
        lasting: see ``Known``.
        known: seeds that the interval is of.
        n_seeds: of the other; infinite: what no number of seeds takes away.
    """
    return float(np.sqrt(lasting + (1 - lasting) * known / n_seeds))


def seeds_needed(known: Known, margin: float, alpha: float, fewest: int = FEWEST) -> int | None:
    """The fewest seeds whose interval would give a verdict, if mean and spread stay what they are.

    Args:
        known: of the gain.
        margin: see ``verdict_of``.
        alpha: error of the t interval.
        fewest: seeds that there are at least.

    Returns:
        None where seeds alone do not bring it: the frames' own interval is too wide, or the gain is about the margin.
    """

    def decides(n_seeds: int) -> bool:
        return verdict_of(known.interval(n_seeds, alpha), n_seeds, margin).is_final

    if np.isnan(known.spread) or not decides(MOST):
        return None
    low, high = max(FEWEST, fewest) - 1, MOST
    while high - low > 1:  # intervals narrow as seeds are added, so what decides goes on deciding
        middle = (low + high) // 2
        low, high = (low, middle) if decides(middle) else (middle, high)
    return high


def is_hopeless(known: Known, margin: float, most: int) -> bool:
    """Whether so many seeds surely bring no verdict, since the frames are too few for one.

    Surely: wherever within its 95 % interval over seeds the mean will come to lie, what is left of the interval over
    frames then neither excludes zero nor lies within the margin.

    Args:
        known: of the gain.
        margin: see ``verdict_of``.
        most: seeds that there will be.
    """
    if known.n_seeds < FEWEST:
        return False
    half = half_width(known.spread, known.n_seeds, ALPHA)
    low, high = known.gain - half, known.gain + half
    below, above = known.reach(most)
    may_be_told = high > below or low < -above
    # Seeds that all gained the same leave the mean a single place, which may lie within the margin all the same.
    may_be_within = max(low, below - margin) <= min(high, margin - above)
    return not (may_be_told or may_be_within)


def smallest_gain(spread: float, n_seeds: int, alpha: float, frames: float = 0.0) -> float:
    """The smallest true gain that so many seeds tell from zero with a chance of four in five.

    Args:
        spread: standard deviation of the gain between seeds.
        n_seeds: at least 2.
        alpha: two-sided error.
        frames: half of the interval over frames, of the same error; 0: they are not counted.
    """
    of_frames = frames * (1 + ndtri(POWER) / ndtri(1 - alpha / 2))
    if spread == 0:
        return float(of_frames)
    critical = stdtrit(n_seeds - 1, 1 - alpha / 2)
    low, high = 0.0, 100.0 + critical  # in standard errors
    while high - low > 1e-6 * high:
        middle = (low + high) / 2
        told = 1 - nctdtr(n_seeds - 1, middle, critical)
        low, high = (middle, high) if told < POWER else (low, middle)
    return float(np.hypot(high * spread / np.sqrt(n_seeds), of_frames))


def seeds_for(
    margin: float,
    spread: float,
    alpha: float,
    frames: float = 0.0,
    lasting: float = 1.0,
    known: int = 1,
) -> int | None:
    """The fewest seeds that tell a gain of the margin; None: not even ``MOST`` do.

    Args:
        margin: AP.
        spread: see ``smallest_gain``.
        alpha: likewise.
        frames: likewise, of ``known`` seeds.
        lasting: share of its variance that more seeds do not take away.
        known: seeds that ``frames`` is of.
    """

    def told(spread: float, n_seeds: int) -> float:
        left = frames * left_of_frames(lasting, known, n_seeds)
        return smallest_gain(spread, n_seeds, alpha, left)

    if told(0.0, MOST) > margin:
        return None
    return next((n for n in range(FEWEST, MOST + 1) if told(spread, n) <= margin), None)
