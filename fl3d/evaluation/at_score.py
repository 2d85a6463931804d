"""What a detector finds at one score: which ground truths, and which of its boxes are false alarms. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.matching import Flags, Float, Int, Matches, most_overlapping
from fl3d.evaluation.protocol import METRICS


@dataclass(frozen=True)
class AtScore:
    """Ground truths and detections where detections below a score are left out.

    Args:
        counts: (G,) which ground truths count.
        found: (G,) of them 1 found, 0 missed, -1 neither: an ignored detection takes it; -1 of all others too.
        hit: (D,) which detections find a ground truth that counts.
        alarm: (D,) which are false alarms.
    """

    counts: NDArray[np.bool_]
    found: Flags
    hit: NDArray[np.bool_]
    alarm: NDArray[np.bool_]


def score_of_alarms(matches: Matches, allowed: int) -> float:
    """The lowest score at and above which a detector makes no more false alarms than allowed.

    Args:
        matches: of one class, metric and difficulty.
        allowed: false alarms in all frames together.

    Returns:
        -inf where all of its detections together make no more, inf where its best ones make more.
    """
    if not len(matches.scores):
        return float("-inf")
    last = np.append(np.diff(matches.scores) != 0, True)  # of the events at one score
    too_many = np.cumsum(matches.fp)[last] > allowed
    if not too_many.any():
        return float("-inf")
    first = int(np.argmax(too_many))
    return float(matches.scores[last][first - 1]) if first else float("inf")


def at_score(
    comparison: Comparison, name: str, metric: str, difficulty: str, score: float
) -> AtScore:
    """What is found at a score by the rules of the evaluator's second pass.

    Args:
        comparison: detections held against ground truths.
        name: of the class.
        metric: ``image``, ``bev`` or ``3d``.
        difficulty: ``easy``, ``moderate`` or ``hard``.
        score: detections below are left out.
    """
    overlaps, m = comparison.overlaps, METRICS.index(metric)
    of_gt, of_det, excused = comparison.flags(name, metric, difficulty)
    scores = np.ascontiguousarray(comparison.det.scores)
    pairs = (overlaps.offsets, overlaps.detection, overlaps.values[m])
    minimum = comparison.protocol.overlaps[name][m]
    by = _takers(*pairs, of_gt, of_det, scores, score, minimum)
    counts, is_taken = of_gt == 0, by >= 0
    is_own = np.zeros(len(by), dtype=bool)
    is_own[is_taken] = of_det[by[is_taken]] == 0
    found = np.full(len(by), -1, dtype=np.int8)
    found[counts & is_taken & is_own], found[counts & ~is_taken] = 1, 0
    taken, hit = np.zeros(len(of_det), dtype=bool), np.zeros(len(of_det), dtype=bool)
    taken[by[is_taken]], hit[by[found == 1]] = True, True
    alarm = (of_det == 0) & (scores >= score) & ~taken & ~excused
    return AtScore(counts, found, hit, alarm)


@numba.njit(cache=True)
def _takers(
    pair_offsets: Int,
    pair_detection: Int,
    overlap: Float,
    gt_flags: Flags,
    det_flags: Flags,
    det_scores: Float,
    score: float,
    minimum: float,
) -> Int:
    """The detection that takes each ground truth, or -1; frames need not be told apart: pairs lie within them."""
    by = np.full(len(gt_flags), -1, dtype=np.int64)
    taken = np.zeros(len(det_flags), dtype=np.bool_)
    for g in range(len(gt_flags)):
        if gt_flags[g] == -1:
            continue
        own = pair_detection[pair_offsets[g] : pair_offsets[g + 1]]
        shared = overlap[pair_offsets[g] : pair_offsets[g + 1]]
        best = most_overlapping(own, shared, det_flags, det_scores, taken, score, minimum)
        if best >= 0:
            taken[best] = True
            by[g] = best
    return by
