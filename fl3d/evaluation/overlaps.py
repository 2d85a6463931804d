"""Overlaps of all detections with all ground truths of their frames, once for all classes, metrics and levels."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.data.label_table import NAMES, LabelTable
from fl3d.geometry.boxes import rectangles_cam
from fl3d.geometry.iou import corners_of, shared_area

Float = NDArray[np.float64]
Int = NDArray[np.int64]
DONTCARE = NAMES.index("dontcare")


@dataclass(frozen=True)
class Overlaps:
    """Pairs that overlap in any metric, ground truth by ground truth, detections in file order.

    Args:
        offsets: (G + 1,) where each ground truth's pairs begin.
        detection: (P,) index into the table of detections.
        values: (3, P) overlap in image, bird's-eye view and 3D.
        dontcare: (D,) largest share of a detection's 2D box that lies in one DontCare region.
    """

    offsets: Int
    detection: Int
    values: Float
    dontcare: Float

    def of(self, chosen: NDArray[np.bool_]) -> Overlaps:
        """Those of some of the detections, (D,), as if there were no others."""
        kept = chosen[self.detection]
        before = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)  # pairs left before each
        number = np.cumsum(chosen) - 1
        left = np.ascontiguousarray(self.values[:, kept])
        detection = number[self.detection[kept]].astype(np.int64)
        return Overlaps(before[self.offsets], detection, left, self.dontcare[chosen])


def find_overlaps(gt: LabelTable, det: LabelTable) -> Overlaps:
    """Overlaps of tables of the same frames."""
    gt_cam, det_cam = np.ascontiguousarray(gt.boxes_cam), np.ascontiguousarray(det.boxes_cam)
    return Overlaps(
        *_pairs(
            gt.offsets,
            det.offsets,
            gt.types,
            np.ascontiguousarray(gt.boxes_image),
            np.ascontiguousarray(det.boxes_image),
            gt_cam,
            det_cam,
            np.ascontiguousarray(rectangles_cam(gt_cam)),
            np.ascontiguousarray(rectangles_cam(det_cam)),
        )
    )


@numba.njit(cache=True)
def _image_shared(a: Float, b: Float) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return width * height if width > 0 and height > 0 else 0.0


@numba.njit(cache=True)
def _pairs(
    gt_offsets: Int,
    det_offsets: Int,
    gt_types: Int,
    gt_image: Float,
    det_image: Float,
    gt_cam: Float,
    det_cam: Float,
    gt_rectangles: Float,
    det_rectangles: Float,
) -> tuple[Int, Int, Float, Float]:
    offsets = np.zeros(len(gt_types) + 1, dtype=np.int64)
    detection = np.empty(1024, dtype=np.int64)
    values = np.empty((3, 1024))
    dontcare = np.zeros(len(det_image))
    p, q = np.empty((4, 2)), np.empty((4, 2))
    n = 0
    for frame in range(len(gt_offsets) - 1):
        first, last = det_offsets[frame], det_offsets[frame + 1]
        for g in range(gt_offsets[frame], gt_offsets[frame + 1]):
            a = gt_rectangles[g]
            is_box = a[2] > 0 and a[3] > 0
            if is_box:
                corners_of(a, p)
            gt_area = (gt_image[g, 2] - gt_image[g, 0]) * (gt_image[g, 3] - gt_image[g, 1])
            for d in range(first, last):
                shared = _image_shared(gt_image[g], det_image[d])
                det_area = (det_image[d, 2] - det_image[d, 0]) * (det_image[d, 3] - det_image[d, 1])
                if gt_types[g] == DONTCARE:
                    if shared > 0 and det_area > 0:
                        dontcare[d] = max(dontcare[d], shared / det_area)
                    continue
                image = shared / (gt_area + det_area - shared) if shared > 0 else 0.0
                bev = volume = 0.0
                b = det_rectangles[d]
                if is_box and b[2] > 0 and b[3] > 0:
                    reach = 0.5 * (np.hypot(a[2], a[3]) + np.hypot(b[2], b[3]))
                    du, dv = a[0] - b[0], a[1] - b[1]
                    if du * du + dv * dv < reach * reach:
                        corners_of(b, q)
                        area = shared_area(q, p)
                        if area > 0:
                            union = a[2] * a[3] + b[2] * b[3] - area
                            bev = area / union
                            low = min(gt_cam[g, 1], det_cam[d, 1])
                            high = max(gt_cam[g, 1] - gt_cam[g, 3], det_cam[d, 1] - det_cam[d, 3])
                            solid = area * max(low - high, 0.0)
                            whole = a[2] * a[3] * gt_cam[g, 3] + b[2] * b[3] * det_cam[d, 3] - solid
                            volume = solid / whole if solid > 0 and whole > 0 else 0.0
                if image > 0 or bev > 0:
                    if n == len(detection):
                        detection = np.concatenate((detection, np.empty_like(detection)))
                        values = np.concatenate((values, np.empty_like(values)), axis=1)
                    detection[n] = d
                    values[0, n], values[1, n], values[2, n] = image, bev, volume
                    n += 1
            offsets[g + 1] = n
    return offsets, detection[:n].copy(), values[:, :n].copy(), dontcare
