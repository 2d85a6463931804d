"""KITTI's matching of detections to ground truths, for all frames of one class, metric and difficulty.

Every object has a flag: 0 counts, 1 is ignored (neither hit nor miss), -1 is not there. Two passes: the first finds
the scores at which recall grows, the second counts hits and false alarms as the score threshold falls. The second
matches a frame again only when another of its detections that touch a ground truth appears; the other false alarms are
only counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Flags = NDArray[np.int8]


@dataclass(frozen=True)
class Matches:
    """All that an AP needs; frames can be weighed, so that resampling needs no matching.

    Args:
        n_gt: (F,) ground truths of each frame that count.
        hit_scores: (H,) falling; the hits of the first pass.
        hit_frames: (H,) their frames.
        scores: (E,) falling; thresholds at which the counts of a frame change.
        frames: (E,) the frame that changes.
        tp: (E,) by how many its true positives change.
        fp: (E,) by how many its false positives change.
        similarity: (E,) by how much the orientation similarity of its true positives changes.
    """

    n_gt: Int
    hit_scores: Float
    hit_frames: Int
    scores: Float
    frames: Int
    tp: Int
    fp: Int
    similarity: Float


def sort_matches(
    n_gt: Int, hits: tuple[Float, Int], events: tuple[Float, Int, Int, Int, Float]
) -> Matches:
    """Arrange what ``match_frames`` found by falling score."""
    scores, frames, tp, fp, similarity = events
    first, then = np.argsort(-hits[0], kind="stable"), np.argsort(-scores, kind="stable")
    return Matches(
        n_gt,
        hits[0][first],
        hits[1][first],
        scores[then],
        frames[then],
        tp[then],
        fp[then],
        similarity[then],
    )


@numba.njit(cache=True)
def _best_scored(
    own: Int,
    overlap: Float,
    flags: Flags,
    scores: Float,
    taken: NDArray[np.bool_],
    touches: NDArray[np.bool_],
    minimum: float,
) -> int:
    """Of a ground truth's detections the free one of the highest score, or -1; marks all that touch it."""
    best = -1
    for d, shared in zip(own, overlap):  # noqa: B905 - numba's zip takes no keyword
        if flags[d] == -1 or not shared > minimum:
            continue
        touches[d] = True
        if not taken[d] and (best < 0 or scores[d] > scores[best]):
            best = d
    return best


@numba.njit(cache=True)
def most_overlapping(
    own: Int,
    overlap: Float,
    flags: Flags,
    scores: Float,
    taken: NDArray[np.bool_],
    level: float,
    minimum: float,
) -> int:
    """Of a ground truth's detections the free one of most overlap, or -1; one that counts goes first."""
    best, best_overlap, best_ignored = -1, 0.0, False
    for d, shared in zip(own, overlap):  # noqa: B905 - numba's zip takes no keyword
        if flags[d] == -1 or taken[d] or scores[d] < level or not shared > minimum:
            continue
        if flags[d] == 0 and (shared > best_overlap or best_ignored):
            best, best_overlap, best_ignored = d, shared, False
        elif flags[d] == 1 and best < 0:
            best, best_ignored = d, True
    return best


@numba.njit(cache=True)
def _count_at(
    level: float,
    gts: tuple[int, int],
    dets: tuple[int, int],
    pair_offsets: Int,
    pair_detection: Int,
    overlap: Float,
    gt_flags: Flags,
    det_flags: Flags,
    det_scores: Float,
    is_alarm: NDArray[np.bool_],
    gt_alpha: Float,
    det_alpha: Float,
    taken: NDArray[np.bool_],
    minimum: float,
) -> tuple[int, int, float]:
    """The second pass over a frame at one score: hits, false alarms and orientation similarity of the hits.

    Each ground truth takes the detection of most overlap; ``taken`` is room for which they are.
    """
    taken[dets[0] : dets[1]] = False
    tp, fp, similarity = 0, 0, 0.0
    for g in range(gts[0], gts[1]):
        if gt_flags[g] == -1:
            continue
        own = pair_detection[pair_offsets[g] : pair_offsets[g + 1]]
        shared = overlap[pair_offsets[g] : pair_offsets[g + 1]]
        best = most_overlapping(own, shared, det_flags, det_scores, taken, level, minimum)
        if best >= 0:
            taken[best] = True
            if gt_flags[g] == 0 and det_flags[best] == 0:
                tp += 1
                similarity += (1.0 + np.cos(gt_alpha[g] - det_alpha[best])) / 2.0
    for d in range(dets[0], dets[1]):
        fp += is_alarm[d] and det_scores[d] >= level and not taken[d]
    return tp, fp, similarity


@numba.njit(cache=True)
def match_frames(
    gt_offsets: Int,
    det_offsets: Int,
    pair_offsets: Int,
    pair_detection: Int,
    overlap: Float,
    gt_flags: Flags,
    det_flags: Flags,
    det_scores: Float,
    excused: NDArray[np.bool_],
    gt_alpha: Float,
    det_alpha: Float,
    minimum: float,
) -> tuple[Int, tuple[Float, Int], tuple[Float, Int, Int, Int, Float]]:
    """Match every frame; see ``Matches`` for what comes back, not yet sorted.

    Args:
        gt_offsets: (F + 1,).
        det_offsets: (F + 1,).
        pair_offsets: (G + 1,), see ``overlaps.Overlaps``.
        pair_detection: (P,).
        overlap: (P,) of the metric.
        gt_flags: (G,).
        det_flags: (D,).
        det_scores: (D,).
        excused: (D,) whether a DontCare region excuses a false alarm.
        gt_alpha: (G,) observation angles.
        det_alpha: (D,) likewise.
        minimum: overlap that a hit must exceed.
    """
    n_frames = len(gt_offsets) - 1
    n_gt = np.zeros(n_frames, dtype=np.int64)
    hit_scores, hit_frames = np.empty(len(gt_flags)), np.empty(len(gt_flags), dtype=np.int64)
    size = 2 * len(det_flags)
    scores, frames = np.empty(size), np.empty(size, dtype=np.int64)
    tps, fps, similarities = (
        np.empty(size, dtype=np.int64),
        np.empty(size, dtype=np.int64),
        np.empty(size),
    )
    taken = np.zeros(len(det_flags), dtype=np.bool_)
    touches = np.zeros(len(det_flags), dtype=np.bool_)
    is_alarm = np.zeros(len(det_flags), dtype=np.bool_)  # unless it is taken
    n_hits = n = 0
    for frame in range(n_frames):
        g0, g1, d0, d1 = (
            gt_offsets[frame],
            gt_offsets[frame + 1],
            det_offsets[frame],
            det_offsets[frame + 1],
        )
        # First pass: each ground truth takes the best-scored free detection.
        for g in range(g0, g1):
            if gt_flags[g] == -1:
                continue
            n_gt[frame] += gt_flags[g] == 0
            own = pair_detection[pair_offsets[g] : pair_offsets[g + 1]]
            shared = overlap[pair_offsets[g] : pair_offsets[g + 1]]
            best = _best_scored(own, shared, det_flags, det_scores, taken, touches, minimum)
            if best >= 0:
                taken[best] = True
                if gt_flags[g] == 0 and det_flags[best] == 0:
                    hit_scores[n_hits], hit_frames[n_hits] = det_scores[best], frame
                    n_hits += 1
        # Detections that touch nothing are false alarms from their score on.
        n_touching = 0
        for d in range(d0, d1):
            if touches[d]:
                n_touching += 1
            elif det_flags[d] == 0 and not excused[d]:
                scores[n], frames[n], tps[n], fps[n], similarities[n] = (
                    det_scores[d],
                    frame,
                    0,
                    1,
                    0.0,
                )
                n += 1
        if n_touching == 0:
            continue
        # Second pass, at each score of a touching detection.
        levels = np.unique(det_scores[d0:d1][touches[d0:d1]])[::-1]
        tp_before, fp_before, similarity_before = 0, 0, 0.0
        is_alarm[d0:d1] = touches[d0:d1] & (det_flags[d0:d1] == 0) & ~excused[d0:d1]
        for level in levels:
            tp, fp, similarity = _count_at(
                level, (g0, g1), (d0, d1), pair_offsets, pair_detection, overlap, gt_flags, det_flags, det_scores,
                is_alarm, gt_alpha, det_alpha, taken, minimum,
            )  # fmt: skip
            scores[n], frames[n] = level, frame
            tps[n], fps[n], similarities[n] = (
                tp - tp_before,
                fp - fp_before,
                similarity - similarity_before,
            )
            n += 1
            tp_before, fp_before, similarity_before = tp, fp, similarity
    hits = (hit_scores[:n_hits].copy(), hit_frames[:n_hits].copy())
    events = (
        scores[:n].copy(),
        frames[:n].copy(),
        tps[:n].copy(),
        fps[:n].copy(),
        similarities[:n].copy(),
    )
    return n_gt, hits, events


@numba.njit(cache=True)
def hits_at_recalls(n_gt: int) -> NDArray[np.int64]:
    """Which hits recall is nearest to 0, 1/40, 2/40, ... at: their places among all hits, the best first, (41,).

    Whoever has fewer hits stops at the last one.

    Args:
        n_gt: ground truths that count; not 0.
    """
    found = np.empty(41, dtype=np.int64)
    first = 0
    wanted = 0.0
    for n in range(41):
        # The official loop skips hit i while recall after i + 1 is nearer to what is wanted than after i; once that
        # is false it stays false, and it is where all are found, so the first hit that stays is found by halving.
        low, high = first, max(first, n_gt - 1)
        while low < high:
            middle = (low + high) // 2
            if (middle + 2) / n_gt - wanted < wanted - (middle + 1) / n_gt:
                low = middle + 1
            else:
                high = middle
        found[n] = low
        wanted += 1.0 / 40.0
        first = low + 1
    return found


@numba.njit(cache=True)
def recall_thresholds(scores: Float, repeats: Int, n_gt: int) -> NDArray[np.float64]:
    """Scores at which recall is nearest to 0, 1/40, 2/40, ...

    Args:
        scores: (H,) of all hits of the first pass, falling.
        repeats: (H,) how often each counts.
        n_gt: ground truths that count.
    """
    ends = np.cumsum(repeats)  # how many hits stand above each score, itself included
    last = (ends[-1] if len(ends) else 0) - 1
    if last < 0:
        return np.empty(0)
    kept = np.empty(41)
    n = 0
    for hit in hits_at_recalls(n_gt):
        kept[n] = scores[np.searchsorted(ends, min(hit, last), side="right")]
        n += 1
        if hit >= last:
            break
    return kept[:n].copy()
