"""Recall of boxes at 3D overlaps, for proposals and for final boxes (the report's Tables 1-5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fl3d.data.label_table import LabelTable
from fl3d.evaluation.overlaps import Overlaps
from fl3d.geometry.boxes import Array
from fl3d.geometry.iou import bev_and_3d_iou_velo

OVERLAPS = (0.1, 0.3, 0.5, 0.7, 0.9)


def recall(
    gt: LabelTable,
    overlaps: Overlaps,
    name: str,
    thresholds: Sequence[float] = OVERLAPS,
    own: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Share of ground truths that any box overlaps by more than each threshold in 3D.

    Every label of the class counts, whatever its difficulty; every box counts, whatever its score.

    Args:
        gt: ground truths.
        overlaps: of them and the boxes, see ``overlaps.find_overlaps``.
        name: of the class.
        thresholds: T overlaps.
        own: (D,) which boxes are of the class; None: all.

    Returns:
        (T,) in 0..1; 0 where there is no ground truth.
    """
    best = np.zeros(len(gt.types))
    owner = np.repeat(np.arange(len(gt.types)), np.diff(overlaps.offsets))
    shared = overlaps.values[2]
    if own is not None:
        shared = np.where(own[overlaps.detection], shared, 0.0)
    np.maximum.at(best, owner, shared)
    best = best[gt.of(name)]
    return np.array([(best > t).mean() if len(best) else 0.0 for t in thresholds])


def best_overlaps(frames: Sequence[tuple[Array, Array]]) -> NDArray[np.float64]:
    """How well each object is found by the best of plain boxes, such as a detector's before any cut and suppression.

    Args:
        frames: of each frame the objects (G, 7) and the boxes (N, 7), both ``boxes_velo``.

    Returns:
        3D overlap of each object, frame by frame.
    """
    best = [np.zeros(0)]
    for objects, boxes in frames:
        best.append(bev_and_3d_iou_velo(objects, boxes)[1].max(axis=1, initial=0.0))
    return np.concatenate(best)
