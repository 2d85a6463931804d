"""Rays of the LiDAR through a scene: what each one meets first."""

from __future__ import annotations

import numba
import numpy as np

from fl3d.simulator.echoes import Returns, listen
from fl3d.simulator.hdl64 import (
    CAMERA_LASERS,
    CAMERA_VIEW,
    ELEVATIONS,
    MAX_RANGE,
    ORIGINS,
    SIDEWAYS,
    ray,
    ray_azimuths,
)
from fl3d.simulator.materials import DENSITY, PATCH, ROUGH, TABLE
from fl3d.simulator.noise import chance, patch_noise
from fl3d.simulator.solids import FLAT, MATERIAL, PASS, Float, Int, Solids, enter_solid, hit_ground
from fl3d.simulator.terrain import Ground


def scan(
    solids: Solids,
    n_objects: int,
    ground: Ground,
    rng: np.random.Generator,
    half_view: float = CAMERA_VIEW,
) -> Returns:
    """Turn the LiDAR once.

    Args:
        solids: of the scene.
        n_objects: how many labelled objects own them.
        ground: below.
        rng: noise, drop-out and foliage.
        half_view: degrees to either side of the road ahead; 180 is the whole turn.
    """
    n_rows = CAMERA_LASERS if half_view <= CAMERA_VIEW else len(ELEVATIONS)
    azimuths = ray_azimuths(half_view, n_rows, rng)
    key = int(rng.integers(2**63))
    reach, which, through, alone = _cast(
        azimuths,
        np.deg2rad(ELEVATIONS),
        ORIGINS,
        SIDEWAYS,
        ground.coefficients,
        solids.planes,
        solids.counts,
        solids.corners,
        solids.nearest,
        solids.parts,
        solids.owners,
        n_objects,
        TABLE,
        key,
    )
    return listen(azimuths, reach, which, through, alone, solids, ground, rng)


@numba.njit(cache=True, error_model="numpy")
def _cast(
    azimuths: Float,
    elevations: Float,
    heights: Float,
    sideways: Float,
    ground: Float,
    planes: Float,
    counts: Int,
    corners: Float,
    nearest: Float,
    parts: Float,
    owners: Int,
    n_objects: int,
    table: Float,
    key: int,
) -> tuple[Float, Int, Int, Int]:
    """First hit of each ray (rows, columns): its range, which solid (-1: ground) and through which plane.

    Also, for each object, how many rays it would stop alone.
    """
    n_rows, n_columns = azimuths.shape
    reach = np.full((n_rows, n_columns), 1e9)
    which = np.full((n_rows, n_columns), -1, dtype=np.int64)
    through = np.zeros((n_rows, n_columns), dtype=np.int64)
    counted = np.zeros(
        (n_rows, n_columns), dtype=np.uint64
    )  # a bit for each object (those 64 apart share one)
    alone = np.zeros(n_objects, dtype=np.int64)
    cos_az, sin_az = np.cos(azimuths), np.sin(azimuths)
    cos_el, sin_el = np.cos(elevations), np.sin(elevations)
    o, d, point = np.zeros(3), np.zeros(3), np.zeros(3)
    for row in range(n_rows):
        for column in range(n_columns):
            ray(row, column, cos_az, sin_az, cos_el, sin_el, heights, sideways, o, d)
            reach[row, column] = hit_ground(ground, o, d)
    step = (azimuths[0, n_columns - 1] - azimuths[0, 0]) / (n_columns - 1)
    for s in range(len(owners)):
        right, left = _sector(corners[s], nearest[s])
        low, high, far = 1e9, -1e9, 0.0
        for k in range(corners.shape[1]):
            low, high = min(low, corners[s, k, 2]), max(high, corners[s, k, 2])
            far = max(far, np.hypot(corners[s, k, 0], corners[s, k, 1]))
        near = max(nearest[s], 0.3)
        material = int(parts[s, MATERIAL])
        density, rough, patch = (
            table[material, DENSITY],
            table[material, ROUGH],
            table[material, PATCH],
        )
        for row in range(n_rows):
            up, down = high - heights[row], low - heights[row]
            if np.tan(elevations[row]) > up / (near if up > 0 else far) + 0.003:
                continue
            if np.tan(elevations[row]) < down / (far if down > 0 else near) - 0.003:
                continue
            for turn in range(-1, 2):  # the lasers' azimuths run a little over the whole turn
                # the encoder's whole steps shift a column by up to one
                first = max(
                    0, int(np.floor((right + 2 * np.pi * turn - azimuths[row, 0]) / step)) - 1
                )
                last = min(
                    n_columns, int(np.ceil((left + 2 * np.pi * turn - azimuths[row, 0]) / step)) + 2
                )
                for column in range(first, last):
                    if owners[s] < 0 and reach[row, column] < near:
                        continue
                    ray(row, column, cos_az, sin_az, cos_el, sin_el, heights, sideways, o, d)
                    met, plane = _meet(
                        planes[s],
                        counts[s],
                        s,
                        row * n_columns + column,
                        density,
                        parts[s, PASS],
                        key,
                        o,
                        d,
                    )
                    if met > MAX_RANGE:
                        continue
                    if owners[s] >= 0:
                        bit = np.uint64(1) << np.uint64(owners[s] % 64)
                        alone[owners[s]] += 1 if counted[row, column] & bit == 0 else 0
                        counted[row, column] |= bit
                    if rough > 0:
                        for axis in range(3):
                            point[axis] = o[axis] + met * d[axis]
                        met += rough * patch_noise(key, s, point, patch)
                    if met < reach[row, column]:
                        reach[row, column], which[row, column], through[row, column] = met, s, plane
    return reach, which, through, alone


@numba.njit(cache=True, error_model="numpy", inline="always")
def _meet(
    planes: Float,
    count: int,
    s: int,
    number: int,
    density: float,
    opening: float,
    key: int,
    o: Float,
    d: Float,
) -> tuple[float, int]:
    """Where a ray ends in a solid, and through which plane it came; 1e9 where it misses or passes."""
    enter, leave, plane = enter_solid(planes, count, o, d)
    if enter >= leave or enter <= 0:
        return 1e9, 0
    if density > 0:
        enter -= np.log(1 - chance(key, number, s)) / density
        if enter > leave:
            return 1e9, 0
    elif abs(planes[plane, 2]) < FLAT and chance(key, number, s) < opening:
        return 1e9, 0
    return enter, plane


@numba.njit(cache=True, error_model="numpy")
def _sector(corners: Float, near: float) -> tuple[float, float]:
    """Azimuths between which a solid lies, right and left."""
    if near < 0.5:
        return -4.0, 4.0
    x = y = 0.0
    for k in range(len(corners)):
        x += corners[k, 0]
        y += corners[k, 1]
    middle = np.arctan2(y, x)
    left = right = 0.0
    for k in range(len(corners)):
        turn = np.arctan2(corners[k, 1], corners[k, 0]) - middle
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        left, right = max(left, turn), min(right, turn)
    return middle + right - 0.03 / near, middle + left + 0.03 / near
