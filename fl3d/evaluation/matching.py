"""KITTI's matching of detections to ground truths, rule by rule. Numbers in comments: the official evaluator's order.

For one class and difficulty every object has a flag: 0 counts, 1 is ignored (neither hit nor miss), -1 is not there.
Two passes: the first finds the scores at which recall grows, the second counts hits and false alarms at each of them.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Flags = NDArray[np.int8]


@numba.njit(cache=True)
def matched_scores(
    overlap: Float, det_scores: Float, gt_flags: Flags, det_flags: Flags, minimum: float
) -> NDArray[np.float64]:
    """First pass, one frame: scores of the hits when each ground truth takes the best-scored free detection.

    Args:
        overlap: (D, G).
        det_scores: (D,).
        gt_flags: (G,).
        det_flags: (D,).
        minimum: overlap that a hit must exceed.
    """
    taken = np.zeros(len(det_scores), dtype=np.bool_)
    hits = np.empty(len(gt_flags))
    n_hits = 0
    for g in range(len(gt_flags)):
        if gt_flags[g] == -1:
            continue
        best = -1
        for d in range(len(det_scores)):
            if det_flags[d] == -1 or taken[d] or not overlap[d, g] > minimum:
                continue
            if best < 0 or det_scores[d] > det_scores[best]:
                best = d
        if best < 0:
            continue
        taken[best] = True
        if gt_flags[g] == 0 and det_flags[best] == 0:
            hits[n_hits] = det_scores[best]
            n_hits += 1
    return hits[:n_hits].copy()


@numba.njit(cache=True)
def count(
    overlap: Float,
    dontcare: Float,
    det_scores: Float,
    gt_flags: Flags,
    det_flags: Flags,
    minimum: float,
    threshold: float,
) -> tuple[int, int]:
    """Second pass, one frame, one threshold: true and false positives.

    Each ground truth takes the free detection that overlaps it most; one that counts replaces an ignored one.

    Args:
        overlap: (D, G).
        dontcare: (D, R) share of each detection that lies in each DontCare region.
        det_scores: (D,).
        gt_flags: (G,).
        det_flags: (D,).
        minimum: overlap that a hit must exceed.
        threshold: detections scored below are not there.
    """
    n_det = len(det_scores)
    taken = np.zeros(n_det, dtype=np.bool_)
    tp = 0
    for g in range(len(gt_flags)):
        if gt_flags[g] == -1:
            continue
        best, best_overlap, best_ignored = -1, 0.0, False
        for d in range(n_det):
            if det_flags[d] == -1 or taken[d] or det_scores[d] < threshold or not overlap[d, g] > minimum:
                continue
            if det_flags[d] == 0 and (overlap[d, g] > best_overlap or best_ignored):
                best, best_overlap, best_ignored = d, overlap[d, g], False
            elif det_flags[d] == 1 and best < 0:
                best, best_ignored = d, True
        if best < 0:
            continue
        taken[best] = True
        if gt_flags[g] == 0 and det_flags[best] == 0:
            tp += 1
    fp = 0
    for d in range(n_det):
        if taken[d] or det_flags[d] != 0 or det_scores[d] < threshold:
            continue
        excused = False
        for r in range(dontcare.shape[1]):
            if dontcare[d, r] > minimum:
                excused = True
                break
        if not excused:
            fp += 1
    return tp, fp


@numba.njit(cache=True)
def recall_thresholds(scores: Float, n_gt: int) -> NDArray[np.float64]:
    """Scores at which recall is nearest to 0, 1/40, 2/40, ...

    Args:
        scores: of all hits of the first pass, falling.
        n_gt: ground truths that count.
    """
    kept = np.empty(len(scores))
    n = 0
    wanted = 0.0
    for i in range(len(scores)):
        here = (i + 1) / n_gt
        last = i == len(scores) - 1
        following = here if last else (i + 2) / n_gt
        if following - wanted < wanted - here and not last:
            continue
        kept[n] = scores[i]
        n += 1
        wanted += 1.0 / 40.0
    return kept[:n].copy()
