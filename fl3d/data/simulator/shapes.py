"""Solids that rays can hit: convex polytopes and ellipsoids. LiDAR frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_PLANES = 8
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """One solid.

    Args:
        planes: (MAX_PLANES, 4) rows n, d of half-spaces n.x <= d; unused rows are (0, 0, 0, 1). For an
            ellipsoid, row 0 is its centre and row 1 its three radii.
        sphere: (4,) a sphere around it: centre, radius.
        ellipsoid: whether ``planes`` describes an ellipsoid.
        reflectance: 0..1.
        porosity: share of rays that pass; the others end anywhere along their way through (foliage).
    """

    planes: Float
    sphere: Float
    ellipsoid: bool
    reflectance: float
    porosity: float


def prism(
    center: tuple[float, float, float],
    yaw: float,
    base: tuple[float, float],
    top: tuple[float, float],
    height: float,
    shift: float = 0.0,
    reflectance: float = 0.4,
    porosity: float = 0.0,
) -> Shape:
    """A box whose sides may lean: a rectangle below, another above.

    Args:
        center: of the base.
        yaw: heading of the length axis.
        base: length and width below.
        top: length and width above.
        height: between both.
        shift: of the top along the length.
        reflectance: see ``Shape``.
        porosity: see ``Shape``.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    planes = np.zeros((MAX_PLANES, 4))
    planes[:, 3] = 1
    local = [(0.0, 0.0, -1.0, 0.0), (0.0, 0.0, 1.0, height)]
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            low, high = 0.5 * base[axis], 0.5 * top[axis] + sign * (shift if axis == 0 else 0.0)
            normal = np.zeros(3)
            normal[axis], normal[2] = sign * height, low - high
            normal /= np.linalg.norm(normal)
            local.append((*normal, sign * normal[axis] * low))
    for row, (nx, ny, nz, d) in enumerate(local):
        normal = turn @ np.array([nx, ny, nz])
        planes[row, :3], planes[row, 3] = normal, d + normal @ np.array(center)
    half = 0.5 * np.array([max(base[0], top[0] + 2 * abs(shift)), max(base[1], top[1]), height])
    middle = (center[0], center[1], center[2] + height / 2)
    return Shape(planes, np.array([*middle, np.linalg.norm(half)]), False, reflectance, porosity)


def box(
    center: tuple[float, float, float],
    yaw: float,
    size: tuple[float, float, float],
    reflectance: float = 0.4,
    porosity: float = 0.0,
) -> Shape:
    """An upright box: bottom centre, heading, (length, width, height)."""
    sides = (size[0], size[1])
    return prism(center, yaw, sides, sides, size[2], reflectance=reflectance, porosity=porosity)


def ellipsoid(
    center: tuple[float, float, float],
    radii: tuple[float, float, float],
    reflectance: float = 0.4,
    porosity: float = 0.0,
) -> Shape:
    """An axis-parallel ellipsoid about its centre."""
    planes = np.zeros((MAX_PLANES, 4))
    planes[0, :3], planes[1, :3] = center, radii
    return Shape(planes, np.array([*center, max(radii)]), True, reflectance, porosity)
