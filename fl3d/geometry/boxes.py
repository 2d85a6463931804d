"""Boxes: every layout, frame, angle and unit of fl3d, declared once. Metres and radians; pixels for images.

LiDAR frame ``_velo``: x forward, y left, z up. Rectified camera frame ``_cam``: x right, y down, z forward.

======================  ======  ==========================================================================
name                    shape   columns
======================  ======  ==========================================================================
``boxes_velo``          (N, 7)  x, y, z of the *bottom* centre, h, w, l, yaw about z (0: length along x)
``boxes_cam``           (N, 7)  x, y, z of the *bottom* centre, h, w, l, ry about y (0: length along x)
``boxes_image``         (N, 4)  x1, y1, x2, y2 in pixels
``rectangles``          (N, 5)  centre u, centre v, length, width, angle counter-clockwise in the (u, v) plane
``corners_velo``        (N, 8, 3)  corners in the order of ``CORNER_SIGNS``
======================  ======  ==========================================================================

A heading and its opposite give the same box, so headings are *folded* into half a turn where a detector
cannot tell front from back.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32] | NDArray[np.float64]

NEAR, NONE = -2, -1  # no owner, see ``owners``
# Signs of (l, w, h) of each corner, h = -1 at the bottom: the fixed order in which 3D-FCN regresses corners.
CORNER_SIGNS = np.array(
    [
        (-1, -1, -1),
        (+1, -1, -1),
        (-1, +1, -1),
        (-1, -1, +1),
        (-1, +1, +1),
        (+1, +1, -1),
        (+1, -1, +1),
        (+1, +1, +1),
    ],
    dtype=np.float64,
)
# Pairs of corners that span one edge; each pair points towards the positive sign.
EDGES_L = ((0, 1), (2, 5), (3, 6), (4, 7))
EDGES_W = ((0, 2), (1, 5), (3, 4), (6, 7))
EDGES_H = ((0, 3), (1, 6), (2, 4), (5, 7))
BOTTOM = (0, 1, 2, 5)


def fold(angle: Array, start: float) -> Array:
    """Fold headings into [start, start + pi): the same box, front and back not told apart."""
    return start + np.mod(angle - start, np.pi)


def wrap(angle: Array) -> Array:
    """Wrap angles into [-pi, pi)."""
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def corners_velo(boxes_velo: Array) -> Array:
    """Corners of boxes in the order of ``CORNER_SIGNS``.

    Args:
        boxes_velo: (N, 7).

    Returns:
        (N, 8, 3) in metres, LiDAR frame.
    """
    h, w, length, yaw = boxes_velo[:, 3], boxes_velo[:, 4], boxes_velo[:, 5], boxes_velo[:, 6]
    along = 0.5 * length[:, None] * CORNER_SIGNS[:, 0]
    across = 0.5 * w[:, None] * CORNER_SIGNS[:, 1]
    up = 0.5 * h[:, None] * (CORNER_SIGNS[:, 2] + 1)
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    offsets = np.stack([along * cos - across * sin, along * sin + across * cos, up], axis=-1)
    return boxes_velo[:, None, :3] + offsets


def boxes_from_corners(corners: Array) -> Array:
    """Nearest box to eight free corners: mean edges, mean centre, vector mean of the eight edge directions.

    Args:
        corners: (N, 8, 3) in the order of ``CORNER_SIGNS``, LiDAR frame.

    Returns:
        ``boxes_velo`` (N, 7); length is never below width (else both are swapped and the heading turned),
        and the heading lies in [-pi, pi).
    """
    along, across, up = (
        np.stack([corners[:, b] - corners[:, a] for a, b in edges], axis=1)
        for edges in (EDGES_L, EDGES_W, EDGES_H)
    )
    length, width, height = (
        np.linalg.norm(edges, axis=-1).mean(axis=1) for edges in (along, across, up)
    )
    # An across edge, turned back by a quarter, points along the length.
    turned = np.stack([across[..., 1], -across[..., 0]], axis=-1)
    directions = np.concatenate([along[..., :2], turned], axis=1)
    directions = directions / np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-9)
    mean = directions.sum(axis=1)
    yaw = np.arctan2(mean[:, 1], mean[:, 0])
    swap = width > length
    yaw = wrap(np.where(swap, yaw + np.pi / 2, yaw))
    centers = corners[..., :2].mean(axis=1)
    bottom = corners[:, BOTTOM, 2].mean(axis=1)
    shapes = [height, np.minimum(width, length), np.maximum(width, length)]
    return np.column_stack([centers, bottom, *shapes, yaw])


def rectangles_velo(boxes_velo: Array) -> Array:
    """Footprints in the (x, y) plane of the LiDAR frame: (N, 5) ``rectangles``."""
    return boxes_velo[:, [0, 1, 5, 4, 6]]


def spans_velo(boxes_velo: Array) -> Array:
    """Lowest and highest z of boxes: (N, 7) ``boxes_velo`` -> (N, 2)."""
    return np.column_stack([boxes_velo[:, 2], boxes_velo[:, 2] + boxes_velo[:, 3]])


def rectangles_cam(boxes_cam: Array) -> Array:
    """Footprints in the (x, z) plane of the camera frame: (N, 5) ``rectangles``."""
    rectangles = boxes_cam[:, [0, 2, 5, 4, 6]].copy()
    rectangles[:, 4] *= -1  # ry turns about the downward y axis
    return rectangles


def standup(rectangles: Array) -> Array:
    """Axis-parallel hulls of rectangles: (N, 5) -> (N, 4) u1, v1, u2, v2."""
    cos, sin = np.abs(np.cos(rectangles[:, 4])), np.abs(np.sin(rectangles[:, 4]))
    half_u = 0.5 * (rectangles[:, 2] * cos + rectangles[:, 3] * sin)
    half_v = 0.5 * (rectangles[:, 2] * sin + rectangles[:, 3] * cos)
    u, v = rectangles[:, 0], rectangles[:, 1]
    return np.column_stack([u - half_u, v - half_v, u + half_u, v + half_v])


def points_inside(points_velo: Points, boxes_velo: Array) -> NDArray[np.bool_]:
    """Which points lie in each box: (P, >=3), (N, 7) -> (N, P)."""
    turn = [(np.cos(yaw), np.sin(yaw)) for yaw in boxes_velo[:, 6]]
    return _inside(points_velo, np.asarray(boxes_velo, np.float64), np.array(turn).reshape(-1, 2))


@numba.njit(cache=True, error_model="numpy")
def _inside(points_velo: Points, boxes_velo: Array, turn: Array) -> NDArray[np.bool_]:
    """``points_inside`` of boxes whose headings' cosines and sines are known: (N, 2)."""
    inside = np.zeros((len(boxes_velo), len(points_velo)), dtype=np.bool_)
    for i in range(len(boxes_velo)):
        x, y, z, h = boxes_velo[i, 0], boxes_velo[i, 1], boxes_velo[i, 2], boxes_velo[i, 3]
        half_w, half_l, cos, sin = (
            boxes_velo[i, 4] / 2,
            boxes_velo[i, 5] / 2,
            turn[i, 0],
            turn[i, 1],
        )
        reach = 1.001 * (half_w + half_l)  # along either axis: most points are told by one look
        for k in range(len(points_velo)):
            dx, dy, dz = points_velo[k, 0] - x, points_velo[k, 1] - y, points_velo[k, 2] - z
            if abs(dx) > reach or abs(dy) > reach:
                continue
            along, across = dx * cos + dy * sin, dy * cos - dx * sin
            is_beside = abs(along) <= half_l and abs(across) <= half_w
            inside[i, k] = is_beside and dz >= 0 and dz <= h
    return inside


def count_points_inside(points_velo: Points, boxes_velo: Array) -> NDArray[np.int64]:
    """How many points lie in each box: (P, >=3), (N, 7) -> (N,)."""
    return points_inside(points_velo, boxes_velo).sum(axis=1)


def owners(points_velo: Points, boxes_velo: Array, margin: float) -> NDArray[np.int64]:
    """Which box each point lies in; ``NEAR`` within ``margin`` metres of one, else ``NONE``: (N, 3), (K, 7) -> (N,)."""
    owner = np.full(len(points_velo), NONE, dtype=np.int64)
    for k, (x, y, z, h, w, length, yaw) in enumerate(boxes_velo):
        dx, dy, dz = points_velo[:, 0] - x, points_velo[:, 1] - y, points_velo[:, 2] - z - h / 2
        along, across = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
        outside = np.maximum.reduce(
            [np.abs(along) - length / 2, np.abs(across) - w / 2, np.abs(dz) - h / 2]
        )
        owner[(outside <= margin) & (owner < 0)] = NEAR
        owner[outside <= 0] = k
    return owner
