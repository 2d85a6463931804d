"""How high the road lies under a place, for objects that are put onto it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fl3d.core.errors import DataError
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.text import finite, read_lines
from fl3d.geometry.boxes import Array, Points

ROADS = ("fitted", "planes")
Height = Callable[[Array], float]
HIGHEST = -1.0  # metres: what lies above, from the sensor at 1.7 m, is not looked at as road
ROUNDS = 4
BELOW, ABOVE = 0.4, 0.15  # metres from the plane that a point of the road may lie


def road_height(frame: Frame, folder: KittiFolder, road: str) -> Height:
    """Height of the road by place: z in metres, LiDAR frame, of (x, y).

    Args:
        frame: whose road.
        folder: of the frame; ``planes`` are its files ``training/planes/ID.txt``.
        road: ``fitted`` or ``planes``.

    Raises:
        DataError: there is no file of the plane, or it is malformed.
    """
    if road == "planes":
        normal, offset = read_plane(folder.path("planes", frame.id))
        return lambda place: _on_plane(place, normal, offset, frame)
    slope = fit_road(frame.points_velo)
    return lambda place: float(slope @ [place[0], place[1], 1.0])


def fit_road(points_velo: Points) -> Array:
    """The plane z = a x + b y + c of the road, by least squares on what lies near the plane of the round before."""
    low = points_velo[points_velo[:, 2] < HIGHEST, :3].astype(np.float64)
    if len(low) < 3:
        return np.array([0.0, 0.0, -1.7])
    slope = np.array([0.0, 0.0, np.percentile(low[:, 2], 30)])
    for _ in range(ROUNDS):
        columns = np.column_stack([low[:, :2], np.ones(len(low))])
        off = low[:, 2] - columns @ slope
        near = (off > -BELOW) & (off < ABOVE)
        if near.sum() < 3:
            break
        slope = np.linalg.lstsq(columns[near], low[near, 2], rcond=None)[0]
    return slope


def read_plane(path: Path) -> tuple[Array, float]:
    """Normal (3,) and offset of a plane in the camera frame: the last line of its file holds four numbers.

    Raises:
        DataError: there is no such file, or its last line is something else.
    """
    lines = [line for line in read_lines(path) if line.strip()]
    values = [
        finite(text, "plane", path, len(lines)) for text in (lines[-1].split() if lines else [])
    ]
    if len(values) != 4 or values[1] == 0:
        raise DataError(
            f"a plane needs four numbers, the second not 0, found {len(values)}", path, len(lines)
        )
    return np.array(values[:3]), values[3]


def _on_plane(place: Array, normal: Array, offset: float, frame: Frame) -> float:
    """Where the vertical through a place meets a plane of the camera frame."""
    ends = np.array([[place[0], place[1], 0.0], [place[0], place[1], -1.0]])
    first, second = frame.calibration.points_to_cam(ends) @ normal + offset
    return float(-first / (first - second))
