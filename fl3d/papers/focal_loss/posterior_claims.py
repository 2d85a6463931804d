"""Sentences of the paper about posteriors: their peak (§VI-C, Figure 5), and who carries the loss (§VI-B). Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fl3d.evaluation.intervals import Interval, interval, joint_intervals
from fl3d.papers.claim import (
    SEEDS_ALONE,
    Claim,
    interval_text,
    over_seeds,
    seeds_in,
    too_few,
    word_of,
)
from fl3d.papers.focal_loss.window_figures import BINS, Array, cumulative_loss

HARDEST = 0.15  # of the positives, that carry half of their loss
HALF = (0.4, 0.6)  # what "roughly half" is taken for
BIN = 1 / BINS
EXACT = 1.001 * BIN  # how exactly a difference of two places is known; so that no rounding decides


@dataclass(frozen=True)
class Peak:
    """Where the histogram of one model's posteriors is highest.

    Args:
        height: density there.
        place: middle of that bin.
    """

    height: float
    place: float


def peak_of(posteriors: Array) -> Peak:
    """The peak of some posteriors, (N,), in the bins of Figure 5."""
    counts, edges = np.histogram(posteriors, bins=BINS, range=(0, 1))
    highest = int(counts.argmax())
    return Peak(float(counts[highest]) / max(1, len(posteriors)) * BINS, edges[highest] + BIN / 2)


def peak_claim(detector: str, kind: str, peaks: Mapping[float, Mapping[int, Peak]]) -> Claim:
    """As gamma grows, the peak of the positives' posteriors decreases and moves lower.

    Judged by the largest gamma against gamma = 0, seed by seed: height and place by t intervals over seeds that hold
    both at once.

    Args:
        detector: whose.
        kind: what is taken for its positives, see ``window_figures.KINDS``.
        peaks: of its last models, by gamma and seed.
    """
    text = f"the peak of the posteriors of {detector}'s {kind} decreases and moves lower as γ grows"
    where = "§VI-C, Fig. 5"
    largest = max(peaks, default=0.0)
    seeds = sorted(set(peaks.get(0.0, {})) & set(peaks.get(largest, {}))) if largest > 0 else []
    if not seeds:
        return Claim(where, text, "decreases", "", "", "")
    pairs = [(peaks[0.0][seed], peaks[largest][seed]) for seed in seeds]
    ends = [_mean_text([pair[side] for pair in pairs]) for side in (0, 1)]
    ours = f"peak {ends[0]} (γ = 0) to {ends[1]} (γ = {largest:g})"
    few = too_few(len(seeds))
    if few:
        return Claim(
            where, text, "decreases", "", f"{ours}; {seeds_in(len(seeds))}", f"ours: {few}"
        )
    height, place = joint_intervals(
        [
            over_seeds([focal.height - base.height for base, focal in pairs]),
            over_seeds([focal.place - base.place for base, focal in pairs]),
        ]
    )
    place = _as_exact_as_bins(place)
    moved = f"height {interval_text(height, 1)}, place {interval_text(place)}"
    verdict = f"ours: height {word_of(height)}, place {word_of(place)}"
    ours = f"{ours}: {moved} {SEEDS_ALONE}; {seeds_in(len(seeds))}"
    return Claim(where, text, "decreases", "", ours, verdict)


def _mean_text(peaks: Sequence[Peak]) -> str:
    height = float(np.mean([peak.height for peak in peaks]))
    place = float(np.mean([peak.place for peak in peaks]))
    return f"{height:.1f} at {place:.2f}"


def _as_exact_as_bins(difference: Interval) -> Interval:
    """No narrower than places are known: equal bins in all seeds are no spread of zero."""
    value = difference.value
    return Interval(value, min(difference.low, value - EXACT), max(difference.high, value + EXACT))


def hardest_share(positive_logits: Array, gamma: float) -> float:
    """Share of the positives' focal loss that lies on their hardest 15 %; logits are (N,)."""
    return 1 - float(cumulative_loss(positive_logits, 1, gamma, np.array([1 - HARDEST]))[0])


def half_claim(gamma: float, shares: Sequence[tuple[float, float]]) -> Claim:
    """The hardest 15 % of 3D-FCN's positives account for half of the positive loss (its best focal model).

    Args:
        gamma: of that model.
        shares: of each seed, under gamma = 0 and under this one; none where there is no such model.
    """
    text = "share of the positive loss on the 15 % hardest positives of 3D-FCN"
    where = "§VI-B"
    if not shares:
        return Claim(where, text, "roughly half", "", "", "")
    under_zero, under_gamma = np.mean(shares, axis=0)
    ours = f"{under_zero:.0%} under γ = 0, {under_gamma:.0%} under γ = {gamma:g}"
    few = too_few(len(shares))
    found = interval(over_seeds([zero for zero, _ in shares]))
    if not few:
        ours += f"; under γ = 0 [{found.low:.0%}, {found.high:.0%}] {SEEDS_ALONE}"
    verdict = f"ours: {few or _about_half(found)}"
    return Claim(where, text, "roughly half", "", f"{ours}; {seeds_in(len(shares))}", verdict)


def _about_half(share: Interval) -> str:
    if HALF[0] < share.low and share.high < HALF[1]:
        return "about half"
    is_apart = share.high < HALF[0] or share.low > HALF[1]
    return "not half" if is_apart else "not distinguishable from half"
