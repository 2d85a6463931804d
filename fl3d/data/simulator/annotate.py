"""KITTI labels of a simulated scene: 2D boxes, truncation and occlusion by KITTI's definitions."""

from __future__ import annotations

import numpy as np

from fl3d.data.calibration import Calibration
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.data.projection import project_boxes
from fl3d.data.simulator.objects import Thing
from fl3d.data.simulator.sensor import Returns

# Share of an object's rays that must reach it to count as visible, or as partly occluded (else largely).
VISIBLE, PARTLY = 0.7, 0.3
MIN_RETURNS = 3  # objects with fewer returns were not annotated by KITTI's annotators either


def annotate(things: list[Thing], returns: Returns, calibration: Calibration, image_size: tuple[int, int]) -> Labels:
    """Labels of the things that the camera and the LiDAR see.

    Args:
        things: labelled objects, in the order of ``returns``.
        returns: of the scan; its ``seen / alone`` gives the occlusion.
        calibration: of the frame.
        image_size: (width, height).
    """
    boxes_velo = np.array([[*t.position, t.size[2], t.size[1], t.size[0], t.yaw] for t in things]).reshape(-1, 7)
    boxes_cam = calibration.boxes_to_cam(boxes_velo)
    full, clipped, ahead = project_boxes(boxes_velo, calibration, image_size)
    area = (full[:, 2] - full[:, 0]) * (full[:, 3] - full[:, 1])
    inside = (clipped[:, 2] - clipped[:, 0]) * (clipped[:, 3] - clipped[:, 1])
    truncated = 1 - np.divide(inside, area, out=np.zeros_like(area), where=area > 0)
    visible = returns.seen / np.maximum(returns.alone, 1)
    occluded = np.where(visible >= VISIBLE, 0, np.where(visible >= PARTLY, 1, 2))
    keep = ahead & (returns.seen >= MIN_RETURNS) & (truncated < 0.95) & (clipped[:, 3] - clipped[:, 1] > 8)
    alpha = boxes_cam[:, 6] - np.arctan2(boxes_cam[:, 0], boxes_cam[:, 2])
    columns = np.column_stack(
        [truncated, occluded, alpha, clipped, boxes_cam[:, 3:6], boxes_cam[:, :3], boxes_cam[:, 6]]
    )
    kinds = [t.kind for t, kept in zip(things, keep, strict=True) if kept]
    return labels_from_columns(kinds, columns[keep], scored=False)
