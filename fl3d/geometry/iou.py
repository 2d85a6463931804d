"""Overlaps of boxes: image, bird's-eye view and 3D, as the KITTI evaluator defines them. Pure NumPy and numba.

The intersection of two rotated rectangles is exact: one is clipped by the four sides of the other
(Sutherland and Hodgman, 1974). Pairs further apart than their half diagonals are not looked at.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.geometry.boxes import Array, rectangles_cam, rectangles_velo

Float = NDArray[np.float64]


@numba.njit(cache=True)
def corners_of(rectangle: Float, out: Float) -> None:
    """Write the counter-clockwise corners (4, 2) of a rectangle (5,)."""
    cos, sin = np.cos(rectangle[4]), np.sin(rectangle[4])
    for k in range(4):
        a = 0.5 * rectangle[2] * (1.0 if k in (0, 3) else -1.0)
        b = 0.5 * rectangle[3] * (1.0 if k < 2 else -1.0)
        out[k, 0] = rectangle[0] + a * cos - b * sin
        out[k, 1] = rectangle[1] + a * sin + b * cos


@numba.njit(cache=True)
def shared_area(p: Float, q: Float) -> float:
    """Area shared by rectangles with counter-clockwise corners ``p`` and ``q`` (each 4, 2)."""
    polygon = np.empty((16, 2))
    clipped = np.empty((16, 2))
    n = 4
    polygon[:4] = p
    for e in range(4):
        ax, ay = q[e, 0], q[e, 1]
        bx, by = q[(e + 1) % 4, 0] - ax, q[(e + 1) % 4, 1] - ay
        m = 0
        for i in range(n):
            cx, cy = polygon[i, 0], polygon[i, 1]
            dx, dy = polygon[(i + 1) % n, 0], polygon[(i + 1) % n, 1]
            side_c = bx * (cy - ay) - by * (cx - ax)
            side_d = bx * (dy - ay) - by * (dx - ax)
            if side_c >= 0:
                clipped[m, 0], clipped[m, 1] = cx, cy
                m += 1
            if (side_c >= 0) != (side_d >= 0):
                t = side_c / (side_c - side_d)
                clipped[m, 0], clipped[m, 1] = cx + t * (dx - cx), cy + t * (dy - cy)
                m += 1
        n = m
        if n < 3:
            return 0.0
        polygon[:n] = clipped[:n]
    area = 0.0
    for i in range(
        1, n - 1
    ):  # fan from the first corner: small numbers, no cancellation far from the origin
        ux, uy = polygon[i, 0] - polygon[0, 0], polygon[i, 1] - polygon[0, 1]
        vx, vy = polygon[i + 1, 0] - polygon[0, 0], polygon[i + 1, 1] - polygon[0, 1]
        area += ux * vy - uy * vx
    return 0.5 * area


@numba.njit(cache=True)
def _shared_areas(a: Float, b: Float, order: NDArray[np.int64], over_union: bool) -> Float:
    """Shared area, or IoU, of each pair; ``order`` sorts ``b`` by its centre's u, so that far pairs are never seen."""
    out = np.zeros((a.shape[0], b.shape[0]))
    radii = 0.5 * np.hypot(b[:, 2], b[:, 3])
    u = b[order, 0]
    widest = radii.max() if len(radii) else 0.0
    p, q = np.empty((4, 2)), np.empty((4, 2))
    for i in range(a.shape[0]):
        if not (a[i, 2] > 0 and a[i, 3] > 0):
            continue
        radius = 0.5 * np.hypot(a[i, 2], a[i, 3])
        corners_of(a[i], p)
        first = np.searchsorted(u, a[i, 0] - radius - widest)
        for k in range(first, len(u)):
            if u[k] > a[i, 0] + radius + widest:
                break
            j = order[k]
            du, dv, reach = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], radius + radii[j]
            if du * du + dv * dv < reach * reach and b[j, 2] > 0 and b[j, 3] > 0:
                corners_of(b[j], q)
                area = shared_area(p, q)
                if area > 0 and over_union:
                    out[i, j] = area / (a[i, 2] * a[i, 3] + b[j, 2] * b[j, 3] - area)
                else:
                    out[i, j] = area
    return out


def intersection_areas(rectangles_a: Array, rectangles_b: Array) -> Float:
    """Shared area of each pair of rotated rectangles.

    Args:
        rectangles_a: (N, 5); a length or width that is not positive overlaps nothing.
        rectangles_b: (M, 5).

    Returns:
        (N, M) in square metres.
    """
    a, b = _contiguous(rectangles_a), _contiguous(rectangles_b)
    return _shared_areas(a, b, np.argsort(b[:, 0]), False)


def bev_iou(rectangles_a: Array, rectangles_b: Array) -> Float:
    """Intersection over union of rotated rectangles: (N, 5), (M, 5) -> (N, M)."""
    a, b = _contiguous(rectangles_a), _contiguous(rectangles_b)
    return _shared_areas(a, b, np.argsort(b[:, 0]), True)


def bev_and_3d_iou_cam(boxes_a: Array, boxes_b: Array) -> tuple[Float, Float]:
    """Overlaps of boxes in the camera frame, sharing one polygon intersection.

    Args:
        boxes_a: (N, 7) ``boxes_cam``; a box spans [y - h, y] vertically.
        boxes_b: (M, 7) ``boxes_cam``.

    Returns:
        bird's-eye-view IoU (N, M) and 3D IoU (N, M).
    """
    # The y axis points down: heights are measured from below.
    return _bev_and_3d(
        rectangles_cam(boxes_a),
        rectangles_cam(boxes_b),
        -boxes_a[:, 1],
        boxes_a[:, 3],
        -boxes_b[:, 1],
        boxes_b[:, 3],
    )


def bev_and_3d_iou_velo(boxes_a: Array, boxes_b: Array) -> tuple[Float, Float]:
    """The same in the LiDAR frame: (N, 7), (M, 7) ``boxes_velo``; a box spans [z, z + h]."""
    return _bev_and_3d(
        rectangles_velo(boxes_a),
        rectangles_velo(boxes_b),
        boxes_a[:, 2],
        boxes_a[:, 3],
        boxes_b[:, 2],
        boxes_b[:, 3],
    )


def _bev_and_3d(
    a: Array, b: Array, bottom_a: Array, height_a: Array, bottom_b: Array, height_b: Array
) -> tuple[Float, Float]:
    shared = intersection_areas(a, b)
    area_a, area_b = a[:, 2] * a[:, 3], b[:, 2] * b[:, 3]
    bev = _ratio(shared, area_a[:, None] + area_b[None] - shared)
    lowest = np.maximum(bottom_a[:, None], bottom_b[None])
    highest = np.minimum((bottom_a + height_a)[:, None], (bottom_b + height_b)[None])
    volume = shared * np.maximum(highest - lowest, 0)
    union = (area_a * height_a)[:, None] + (area_b * height_b)[None] - volume
    return bev, _ratio(volume, union)


def image_iou(boxes_a: Array, boxes_b: Array, over_a: bool = False) -> Float:
    """Overlap of axis-parallel boxes x1, y1, x2, y2.

    Args:
        boxes_a: (N, 4).
        boxes_b: (M, 4).
        over_a: divide by the area of ``boxes_a`` instead of the union (KITTI's rule for DontCare regions).

    Returns:
        (N, M).
    """
    low = np.maximum(boxes_a[:, None, :2], boxes_b[None, :, :2])
    high = np.minimum(boxes_a[:, None, 2:], boxes_b[None, :, 2:])
    size = high - low
    shared = np.where((size > 0).all(axis=-1), size[..., 0] * size[..., 1], 0.0)
    area_a = (boxes_a[:, 2] - boxes_a[:, 0]) * (boxes_a[:, 3] - boxes_a[:, 1])
    area_b = (boxes_b[:, 2] - boxes_b[:, 0]) * (boxes_b[:, 3] - boxes_b[:, 1])
    whole = (
        np.broadcast_to(area_a[:, None], shared.shape)
        if over_a
        else area_a[:, None] + area_b - shared
    )
    return _ratio(shared, whole)


def _ratio(part: Float, whole: Float) -> Float:
    """Divide, with 0 where there is nothing to share (degenerate boxes)."""
    return np.divide(part, whole, out=np.zeros_like(part), where=(part > 0) & (whole > 0))


def _contiguous(rectangles: Array) -> Float:
    return np.ascontiguousarray(rectangles, dtype=np.float64)
