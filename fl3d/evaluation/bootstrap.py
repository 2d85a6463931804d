"""How far an AP moves when the frames are drawn again.

Resampling weighs matches that were made once, so an AP of a resample is exactly the AP of the resampled frames and
nothing is matched again. Detectors that are resampled with the same weights are paired, so that their difference has a
narrower interval than either. What is drawn is a unit: a frame, or a drive with all of its frames.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.evaluation.matching import Float, Int, Matches, hits_at_recalls

Weights = NDArray[np.int32]
Counts = NDArray[np.int32] | NDArray[np.int64]
# With 1000, marks of four or five of 72 cells changed from one seed of the resampling to another.
N_RESAMPLES = 10_000
TAIL = 0.025  # of the intervals that are told, at either end
# Resamples that are counted at once, side by side, so that one instruction counts many: for 5000 events each takes 1.0
# us, and 4.5 where they are 16.
BLOCK = 128
SHORT = np.iinfo(np.int32).max  # counts up to here are half as long


@lru_cache(maxsize=2)  # the same for every detector, class, metric and level
def unit_weights(n_units: int, n_resamples: int = N_RESAMPLES, seed: int = 0) -> Weights:
    """How often each unit is drawn in each resample: (R, U), rows sum to U."""
    rng = np.random.default_rng([seed, n_units])
    weights = np.empty((n_resamples, n_units), dtype=np.int32)
    for row in weights:
        row[:] = np.bincount(rng.integers(n_units, size=n_units), minlength=n_units)
    return weights


def resampled_aps(
    matches: Matches, weights: Weights, units: Int | None = None
) -> NDArray[np.float64]:
    """AP of each resample, percent.

    Args:
        matches: of F frames.
        weights: (R, U) how often each unit counts.
        units: (F,) the unit of each frame; None: each frame is one, U = F.

    Returns:
        (R, 2) R11 and R40; 0 where a resample holds no ground truth.
    """
    m = matches
    own = np.arange(len(m.n_gt)) if units is None else units
    n_gt = np.bincount(own, weights=m.n_gt, minlength=weights.shape[1]).astype(np.int64)
    totals = _totals(n_gt, weights)
    met, which = np.unique(totals, return_inverse=True)
    nothing = np.zeros(N_SAMPLES, dtype=np.int64)
    numbers = np.array([hits_at_recalls(int(n)) if n else nothing for n in met])
    until = np.searchsorted(-m.scores, -m.hit_scores, side="right")
    most = int(weights.max(initial=0)) * int(np.abs(m.tp).sum() + np.abs(m.fp).sum())
    kind = np.int32 if most <= SHORT else np.int64
    events = (until, own[m.frames], m.tp.astype(kind), m.fp.astype(kind))
    return _resample(totals, numbers, which, own[m.hit_frames], *events, weights)


def widened(draws: Float, units: Int) -> Float:
    """Draws with the spread that few units deserve: their percentiles then hold the truth as often as they say.

    A resample of n units varies by (n - 1) / n of what it stands for, and of few units even that is not well known,
    for which Student has t in the place of the normal's quantile (Hesterberg 2015: the expanded percentile interval). n
    is the number of equal units that would tell as much as these. ``benchmarks/README.md`` has the coverage.

    Args:
        draws: (R, ...) in resamples of the units.
        units: (F,) the unit of each frame.
    """
    sizes = np.bincount(units).astype(float)
    n = max(float(sizes.sum() ** 2 / (sizes**2).sum()), 2.0)
    factor = np.sqrt(n / (n - 1)) * stdtrit(n - 1, 1 - TAIL) / ndtri(1 - TAIL)
    middle = draws.mean(axis=0)
    return middle + factor * (draws - middle)


@numba.njit(cache=True)
def _totals(n_gt: Int, weights: Weights) -> Int:
    """Ground truths of each resample: (R,)."""
    totals = np.zeros(len(weights), dtype=np.int64)
    for r in range(len(weights)):
        for unit in range(len(n_gt)):
            totals[r] += weights[r, unit] * n_gt[unit]
    return totals


@numba.njit(cache=True)
def _resample(
    totals: Int,
    numbers: Int,
    which: Int,
    hit_units: Int,
    until: Int,
    units: Int,
    tps: Counts,
    fps: Counts,
    weights: Weights,
) -> Float:
    """APs, (R, 2).

    Args:
        totals: (R,) ground truths.
        numbers: (N, 41) of some numbers of ground truths what ``hits_at_recalls`` gives.
        which: (R,) row of ``numbers``.
        hit_units: (H,) unit of each hit of the first pass, best first.
        until: (H,) events down to the score of each.
        units: (E,) of the events.
        tps: (E,) by how many true positives change.
        fps: (E,) by how many false positives change.
        weights: (R, U).
    """
    aps = np.zeros((len(weights), 2))
    own = np.zeros((weights.shape[1], BLOCK), dtype=tps.dtype)
    tp = np.empty((len(hit_units), BLOCK), dtype=tps.dtype)
    fp = np.empty_like(tp)
    for start in range(0, len(weights), BLOCK):
        n = min(BLOCK, len(weights) - start)
        for r in range(n):
            for unit in range(len(own)):
                own[unit, r] = weights[start + r, unit]
        _count(own, until, units, tps, fps, tp, fp)
        for r in range(start, start + n):
            if totals[r] > 0:
                hits = _thresholds(numbers[which[r]], hit_units, weights[r])
                aps[r] = _averages(hits, tp[:, r - start], fp[:, r - start])
    return aps


@numba.njit(cache=True)
def _count(
    own: Counts, until: Int, units: Int, tps: Counts, fps: Counts, tp: Counts, fp: Counts
) -> None:
    """Count true and false positives down to the score of each hit, in some resamples at once.

    Args:
        own: (U, BLOCK) how often each unit counts in each.
        until: see ``_resample``.
        units: likewise.
        tps: likewise.
        fps: likewise.
        tp: (H, BLOCK) filled.
        fp: likewise.
    """
    true, false = np.zeros_like(own[0]), np.zeros_like(own[0])
    e = 0
    for h in range(len(until)):
        while e < until[h]:
            if tps[e] != 0:
                _add(true, own[units[e]], tps[e])
            if fps[e] != 0:
                _add(false, own[units[e]], fps[e])
            e += 1
        tp[h], fp[h] = true, false


@numba.njit(cache=True)
def _add(total: Counts, own: Counts, times: int) -> None:
    for r in range(len(total)):
        total[r] += own[r] * times


@numba.njit(cache=True)
def _thresholds(at: Int, hit_units: Int, weight: Weights) -> Int:
    """The hits of the first pass whose scores are the thresholds of one resample: (T,).

    Args:
        at: (41,) see ``hits_at_recalls``.
        hit_units: (H,) unit of each hit.
        weight: (U,) how often each unit counts.
    """
    found = np.empty(N_SAMPLES, dtype=np.int64)
    n = seen = 0
    wanted = at[0]
    for h in range(len(hit_units)):
        seen += weight[hit_units[h]]
        while n < N_SAMPLES and wanted < seen:
            found[n] = h
            n += 1
            wanted = at[min(n, N_SAMPLES - 1)]
    if 0 < n < N_SAMPLES and at[n - 1] < seen - 1:  # the last hit, short of the next sample
        last = len(hit_units) - 1
        while weight[hit_units[last]] == 0:
            last -= 1
        found[n] = last
        n += 1
    return found[:n]


@numba.njit(cache=True)
def _averages(hits: Int, tp: Counts, fp: Counts) -> tuple[float, float]:
    """R11 and R40 of one resample, of precision made monotone from the right.

    Args:
        hits: (T,) whose scores are the thresholds.
        tp: (H,) true positives down to the score of each hit.
        fp: (H,) false positives likewise.
    """
    precision = np.zeros(N_SAMPLES)
    for t in range(len(hits)):
        found = tp[hits[t]] + fp[hits[t]]
        precision[t] = tp[hits[t]] / found if found > 0 else 0.0
    for t in range(len(hits) - 2, -1, -1):
        precision[t] = max(precision[t], precision[t + 1])
    return precision[::4].sum() / 11 * 100, precision[1:].sum() / 40 * 100
