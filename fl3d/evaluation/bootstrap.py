"""How sure an AP is: resample the frames, and the training seeds, and look how far it moves.

Resampling weighs matches that were made once, so an AP of a resample is exactly the AP of the resampled frames and
nothing is matched again. Two detectors are resampled together (paired), so that their
difference has a narrower interval than either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError
from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.evaluation.matching import Float, Int, Matches, recall_thresholds

R11_STEP = 100 / 11  # what one more of its recall samples is worth in R11


@dataclass(frozen=True)
class Interval:
    """An estimate and where it lies.

    Args:
        value: on the frames as they are; the mean over seeds where there are several.
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


@lru_cache(maxsize=4)  # the same for every class, metric and level
def frame_weights(n_frames: int, n_resamples: int, seed: int) -> NDArray[np.int64]:
    """How often each frame is drawn in each resample: (R, F), rows sum to F."""
    drawn = np.random.default_rng([seed, n_frames]).integers(n_frames, size=(n_resamples, n_frames))
    return np.stack([np.bincount(row, minlength=n_frames) for row in drawn])


def resampled_aps(matches: Matches, weights: NDArray[np.int64]) -> NDArray[np.float64]:
    """AP of each resample, percent: (R, F) weights -> (R, 2), R11 and R40."""
    m = matches
    return _resample(m.n_gt, m.hit_scores, m.hit_frames, m.scores, m.frames, m.tp, m.fp, weights)


@numba.njit(cache=True)
def _resample(
    n_gt: Int,
    hit_scores: Float,
    hit_frames: Int,
    scores: Float,
    frames: Int,
    tps: Int,
    fps: Int,
    weights: Int,
) -> Float:
    aps = np.zeros((len(weights), 2))
    for r in range(len(weights)):
        weight = weights[r]
        total = 0
        for frame in range(len(n_gt)):
            total += weight[frame] * n_gt[frame]
        if total == 0:
            continue
        thresholds = recall_thresholds(hit_scores, weight[hit_frames], total)
        precision = np.zeros(N_SAMPLES)
        tp = fp = e = 0
        for t in range(len(thresholds)):
            while e < len(scores) and scores[e] >= thresholds[t]:
                tp += weight[frames[e]] * tps[e]
                fp += weight[frames[e]] * fps[e]
                e += 1
            precision[t] = tp / (tp + fp) if tp + fp > 0 else 0.0
        for t in range(len(thresholds) - 2, -1, -1):
            precision[t] = max(precision[t], precision[t + 1])
        aps[r, 0] = precision[::4].sum() / 11 * 100
        aps[r, 1] = precision[1:].sum() / 40 * 100
    return aps


@dataclass(frozen=True)
class Paired:
    """A detector against a baseline.

    Args:
        ap: of the detector, R11 and R40.
        baseline: likewise.
        gain: their difference, likewise.
        one_step: whether the gain in R11 is of the size of one of its recall steps while R40 gains less than half
            as much.
    """

    ap: tuple[Interval, Interval]
    baseline: tuple[Interval, Interval]
    gain: tuple[Interval, Interval]
    one_step: bool


def paired_bootstrap(
    detector: Sequence[Matches],
    baseline: Sequence[Matches],
    n_resamples: int = 1000,
    level: float = 0.95,
    seed: int = 0,
) -> Paired:
    """Intervals of two APs and of their difference, over frames and training seeds.

    Args:
        detector: matches of each training seed, on the same frames.
        baseline: of the same seeds, in the same order: seeds are resampled in pairs as well.
        n_resamples: how many.
        level: of the intervals (percentiles).
        seed: of the resampling.

    Raises:
        ConfigError: different numbers of seeds or frames.
    """
    if len(detector) != len(baseline) or not detector:
        raise ConfigError(
            f"{len(detector)} seeds against {len(baseline)}: a paired bootstrap needs the same seeds"
        )
    n_frames = {len(m.n_gt) for m in [*detector, *baseline]}
    if len(n_frames) != 1:
        raise ConfigError(
            f"matches of {sorted(n_frames)} frames: a paired bootstrap needs the same frames"
        )
    weights = frame_weights(n_frames.pop(), n_resamples, seed)
    once = np.ones((1, weights.shape[1]), dtype=np.int64)
    drawn = np.random.default_rng([seed, 1]).integers(
        len(detector), size=(n_resamples, len(detector))
    )
    values, resamples = [], []
    for side in (detector, baseline):
        values.append(np.mean([resampled_aps(m, once)[0] for m in side], axis=0))
        per_seed = np.stack([resampled_aps(m, weights) for m in side])  # (S, R, 2)
        resamples.append(per_seed[drawn, np.arange(n_resamples)[:, None]].mean(axis=1))
    (a, b), (ra, rb) = values, resamples
    gain = _intervals(a - b, ra - rb, level)
    r11, r40 = gain[0].value, gain[1].value
    # A step is worth 9.09 times the precision there; less is lost or won elsewhere. R40 tells a step from a real gain.
    step = R11_STEP / 4 < abs(r11) < R11_STEP * 1.5 and r40 * np.sign(r11) < abs(r11) / 2
    return Paired(_intervals(a, ra, level), _intervals(b, rb, level), gain, bool(step))


def _intervals(value: Float, resamples: Float, level: float) -> tuple[Interval, Interval]:
    tail = (1 - level) / 2 * 100
    low, high = np.percentile(resamples, [tail, 100 - tail], axis=0)
    first, second = (
        Interval(float(v), float(lo), float(hi)) for v, lo, hi in zip(value, low, high, strict=True)
    )
    return first, second
