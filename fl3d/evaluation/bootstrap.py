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
from fl3d.evaluation.matching import Float, Int, Matches, recall_thresholds

Weights = NDArray[np.int32]
# With 1000, marks of four or five of 72 cells changed from one seed of the resampling to another.
N_RESAMPLES = 10_000
TAIL = 0.025  # of the intervals that are told, at either end


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
    hit_units = own[m.hit_frames]
    event_units = own[m.frames]
    return _resample(n_gt, m.hit_scores, hit_units, m.scores, event_units, m.tp, m.fp, weights)


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
def _resample(
    n_gt: Int,
    hit_scores: Float,
    hit_units: Int,
    scores: Float,
    units: Int,
    tps: Int,
    fps: Int,
    weights: Weights,
) -> Float:
    aps = np.zeros((len(weights), 2))
    for r in range(len(weights)):
        weight = weights[r].astype(np.int64)
        total = 0
        for unit in range(len(n_gt)):
            total += weight[unit] * n_gt[unit]
        if total == 0:
            continue
        thresholds = recall_thresholds(hit_scores, weight[hit_units], total)
        precision = np.zeros(N_SAMPLES)
        tp = fp = e = 0
        for t in range(len(thresholds)):
            while e < len(scores) and scores[e] >= thresholds[t]:
                tp += weight[units[e]] * tps[e]
                fp += weight[units[e]] * fps[e]
                e += 1
            precision[t] = tp / (tp + fp) if tp + fp > 0 else 0.0
        for t in range(len(thresholds) - 2, -1, -1):
            precision[t] = max(precision[t], precision[t + 1])
        aps[r, 0] = precision[::4].sum() / 11 * 100
        aps[r, 1] = precision[1:].sum() / 40 * 100
    return aps
