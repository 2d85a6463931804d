"""An HDL-64E-like LiDAR: 64 beams in two blocks, cast against a scene's shapes and ground."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.data.simulator.shapes import Float, Shape

# Two blocks of 32 lasers, degrees; each block leaves the housing at its own height above the LiDAR origin.
UPPER = np.linspace(1.94, -8.71, 32)
LOWER = np.linspace(-9.03, -25.0, 32)
ORIGIN_UPPER, ORIGIN_LOWER = 0.20, 0.12  # metres
AZIMUTH_STEP = 0.17  # degrees, at 10 turns a second
HALF_VIEW = 44.0  # degrees: a little more than the camera sees
MIN_RANGE, MAX_RANGE = 2.0, 120.0  # metres
RANGE_NOISE = 0.02  # metres, one standard deviation
GROUND_ROUGHNESS = 0.02  # metres
GROUND, CLUTTER = -1, -2  # owners that are no objects
FAINTEST = 0.004  # mean of the detection threshold; see `_heard`


@dataclass(frozen=True)
class Ground:
    """z = height + slope_x x + slope_y y, in the LiDAR frame."""

    height: float
    slope_x: float
    slope_y: float

    def at(self, x: float, y: float) -> float:
        """Height at a place."""
        return self.height + self.slope_x * x + self.slope_y * y


@dataclass(frozen=True)
class Returns:
    """What came back.

    Args:
        points_velo: (N, 4) float32.
        alone: (O,) rays that would hit each object if nothing else stood there.
        seen: (O,) rays that do.
    """

    points_velo: NDArray[np.float32]
    alone: NDArray[np.int64]
    seen: NDArray[np.int64]


@numba.njit(cache=True)
def _enter(planes: Float, ellipsoid: bool, o: Float, d: Float) -> tuple[float, float, float]:
    """Where ray o + t d enters and leaves a shape, and the cosine of incidence; enter > leave: a miss."""
    if ellipsoid:
        a = b = c = 0.0
        for k in range(3):
            u, v = (o[k] - planes[0, k]) / planes[1, k], d[k] / planes[1, k]
            a += v * v
            b += u * v
            c += u * u
        root = b * b - a * (c - 1)
        if root <= 0:
            return 1.0, 0.0, 0.0
        root = np.sqrt(root)
        return (-b - root) / a, (-b + root) / a, 0.7
    enter, leave, cosine = -1e9, 1e9, 0.0
    for k in range(planes.shape[0]):
        slope = planes[k, 0] * d[0] + planes[k, 1] * d[1] + planes[k, 2] * d[2]
        gap = planes[k, 3] - (planes[k, 0] * o[0] + planes[k, 1] * o[1] + planes[k, 2] * o[2])
        if slope == 0.0:
            if gap < 0:
                return 1.0, 0.0, 0.0
        elif slope < 0:
            if gap / slope > enter:
                enter, cosine = gap / slope, -slope
        else:
            leave = min(leave, gap / slope)
    return enter, leave, cosine


@numba.njit(cache=True)
def _cast(
    azimuths: Float,
    elevations: Float,
    heights: Float,
    ground: Float,
    planes: Float,
    spheres: Float,
    ellipsoids: NDArray[np.bool_],
    materials: Float,
    owners: NDArray[np.int64],
    n_objects: int,
    chance: Float,
) -> tuple[Float, Float, NDArray[np.int64], NDArray[np.int64]]:
    """Nearest hit of each ray: range, echo strength and owner (columns, rows); and each object's `alone`."""
    n_columns, n_rows = len(azimuths), len(elevations)
    nearest = np.full((n_columns, n_rows), 1e9)
    echo = np.zeros((n_columns, n_rows))
    owner = np.full((n_columns, n_rows), -1, dtype=np.int64)
    counted = np.full((n_columns, n_rows), -1, dtype=np.int64)
    alone = np.zeros(n_objects, dtype=np.int64)
    o, d = np.zeros(3), np.zeros(3)
    for row in range(n_rows):
        o[2] = heights[row]
        for column in range(n_columns):
            d[0] = np.cos(elevations[row]) * np.cos(azimuths[column])
            d[1] = np.cos(elevations[row]) * np.sin(azimuths[column])
            d[2] = np.sin(elevations[row])
            slope = d[2] - ground[1] * d[0] - ground[2] * d[1]
            if slope < 0:
                nearest[column, row] = (ground[0] - o[2]) / slope
                echo[column, row] = 0.25 * -slope
    step = azimuths[0] - azimuths[1]
    for s in range(planes.shape[0]):
        x, y, z, radius = spheres[s]
        distance = np.hypot(x, y)
        first, last = 0, n_columns
        if distance > radius:
            middle, spread = np.arctan2(y, x), np.arcsin(radius / distance)
            first = max(0, int(np.ceil((azimuths[0] - middle - spread) / step)))
            last = min(n_columns, int(np.floor((azimuths[0] - middle + spread) / step)) + 1)
        for column in range(first, last):
            for row in range(n_rows):
                o[2] = heights[row]
                d[0] = np.cos(elevations[row]) * np.cos(azimuths[column])
                d[1] = np.cos(elevations[row]) * np.sin(azimuths[column])
                d[2] = np.sin(elevations[row])
                along = x * d[0] + y * d[1] + (z - o[2]) * d[2]
                if x * x + y * y + (z - o[2]) ** 2 - along * along > radius * radius:
                    continue
                enter, leave, cosine = _enter(planes[s], ellipsoids[s], o, d)
                if enter >= leave or enter <= 0:
                    continue
                if materials[s, 1] > 0:  # foliage: the ray passes, or ends somewhere inside
                    draw = chance[column, row] * 7919 * (s + 1) % 1.0
                    if draw < materials[s, 1]:
                        continue
                    enter += (leave - enter) * 0.6 * (draw - materials[s, 1]) / (1 - materials[s, 1])
                if owners[s] >= 0 and counted[column, row] != owners[s]:
                    counted[column, row] = owners[s]
                    alone[owners[s]] += 1
                if enter < nearest[column, row]:
                    nearest[column, row] = enter
                    echo[column, row] = materials[s, 0] * cosine
                    owner[column, row] = owners[s]
    return nearest, echo, owner, alone


def scan(
    shapes: list[Shape],
    owners: list[int],
    n_objects: int,
    ground: Ground,
    rng: np.random.Generator,
) -> Returns:
    """Turn the LiDAR once over the camera's view.

    Args:
        shapes: of the scene; those of one object must follow each other.
        owners: the object of each shape, or ``CLUTTER``.
        n_objects: how many objects there are.
        ground: under it all.
        rng: noise, drop-out and foliage.
    """
    azimuths = np.deg2rad(np.arange(HALF_VIEW, -HALF_VIEW, -AZIMUTH_STEP) + rng.uniform(0, AZIMUTH_STEP))
    elevations = np.deg2rad(np.concatenate([UPPER, LOWER]))
    heights = np.repeat([ORIGIN_UPPER, ORIGIN_LOWER], 32)
    chance = rng.random((len(azimuths), len(elevations)))
    reached, echo, owner, alone = _cast(
        azimuths,
        elevations,
        heights,
        np.array([ground.height, ground.slope_x, ground.slope_y]),
        np.stack([s.planes for s in shapes]),
        np.stack([s.sphere for s in shapes]),
        np.array([s.ellipsoid for s in shapes]),
        np.array([[s.reflectance, s.porosity] for s in shapes]),
        np.array(owners, dtype=np.int64),
        n_objects,
        chance,
    )
    hit = (reached > MIN_RANGE) & (reached < MAX_RANGE) & _heard(echo, reached, rng)
    seen = np.bincount(owner[hit & (owner >= 0)], minlength=n_objects)
    noisy = reached + rng.normal(0, RANGE_NOISE, reached.shape)
    cos = np.cos(elevations)
    x = noisy * cos * np.cos(azimuths)[:, None]
    y = noisy * cos * np.sin(azimuths)[:, None]
    z = noisy * np.sin(elevations) + heights
    z = z + np.where(owner == GROUND, rng.normal(0, GROUND_ROUGHNESS, z.shape), 0.0)
    reflectance = np.clip(echo + rng.normal(0, 0.03, echo.shape), 0, 0.99)
    points = np.stack([x, y, z, reflectance], axis=-1)[hit]
    return Returns(points.astype(np.float32), alone, seen.astype(np.int64))


def _heard(echo: Float, reached: Float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which echoes rise above a random threshold: dark, oblique and distant surfaces drop out."""
    strength = echo / np.maximum(reached / 20, 0.5) ** 2
    lost = rng.random(echo.shape) < 0.03
    return (strength > rng.exponential(FAINTEST, echo.shape)) & ~lost
