"""Boxes in the picture: the rectangle around a projected box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fl3d.data.calibration import Calibration
from fl3d.geometry.boxes import Array, corners_velo

NEAR = 0.1  # metres: corners behind the camera are moved to this depth before they are projected


def project_boxes(
    boxes_velo: Array, calibration: Calibration, image_size: tuple[int, int]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Rectangles around projected boxes.

    Args:
        boxes_velo: (N, 7).
        calibration: of the frame.
        image_size: (width, height) in pixels.

    Returns:
        the full rectangles (N, 4), the same cut at the picture's border (N, 4), and which boxes have their
        centre in front of the camera and any part in the picture (N,).
    """
    corners = corners_velo(boxes_velo).reshape(-1, 3)
    corners_cam = calibration.points_to_cam(corners)
    corners_cam[:, 2] = np.maximum(corners_cam[:, 2], NEAR)
    pixels = calibration.points_to_image(corners_cam)[0].reshape(-1, 8, 2)
    full = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    width, height = image_size
    limits = np.array([width - 1, height - 1, width - 1, height - 1])
    clipped = np.clip(full, 0, limits)
    some = (clipped[:, 2] > clipped[:, 0]) & (clipped[:, 3] > clipped[:, 1])
    ahead = calibration.points_to_cam(boxes_velo)[:, 2] > NEAR
    return full, clipped, ahead & some
