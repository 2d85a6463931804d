"""From hits to points: range noise, strength of the echo, and what never comes back."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.simulator.hdl64 import (
    ELEVATIONS,
    MAX_RANGE,
    MIN_RANGE,
    ORIGINS,
    RANGE_NOISE,
    SIDEWAYS,
    is_blind,
    ray,
)
from fl3d.simulator.materials import DARK, DENSITY, GLOSS, LOSS, TABLE
from fl3d.simulator.solids import MATERIAL, REFLECTANCE, Float, Int, Solids, normal_at
from fl3d.simulator.terrain import Ground, bumps

FAINT = 6e-6  # reflectance x cosine / range^2 below which most echoes are lost
DIM = 2.6e-5  # and below which they have no strength: the ground's beyond 25 m
SHINY = 20.0  # how much sooner paint and metal look black: half the points on cars have no strength
WEAK = (35, 36, 42)  # lasers whose echoes come out as dark
GROUND_REFLECTANCE = 0.29
_GAINS = np.where(np.isin(np.arange(64), WEAK), 0.15, 1.0)
GROUND = -1  # owner of what is no object
MEETINGS, FARTHEST = 2, 2.0  # steps to where a ray meets uneven ground; metres that it may move
QUIETER = 0.28  # share of the range's noise that is the road's unevenness where that is a surface
EDGE = 1.5  # metres, half a pulse: closer echoes of one beam are told as one
MIXED = 0.3  # share of the beams at such an edge whose echo lies between both surfaces


@dataclass(frozen=True)
class Returns:
    """What came back.

    Args:
        points_velo: (N, 4) float32, ring by ring as KITTI's files.
        alone: (O,) rays that would hit each object if nothing else stood there.
        seen: (O,) rays that do.
        counts: (O,) points that lie on each object.
    """

    points_velo: NDArray[np.float32]
    alone: Int
    seen: Int
    counts: Int


def listen(
    azimuths: Float,
    reach: Float,
    which: Int,
    through: Int,
    alone: Int,
    solids: Solids,
    ground: Ground,
    rng: np.random.Generator,
) -> Returns:
    """From hits to points.

    Args:
        azimuths: of the rays in radians, (rows, columns).
        reach: metres to each ray's first hit.
        which: solid that was hit, -1 for the ground.
        through: which of its planes.
        alone: see ``Returns``.
        solids: of the scene.
        ground: below.
        rng: noise, and what is lost.
    """
    points, owner = _listen(
        azimuths,
        np.deg2rad(ELEVATIONS),
        ORIGINS,
        SIDEWAYS,
        reach,
        which,
        through,
        ground.coefficients,
        ground.road_coefficients,
        _GAINS,
        solids.planes,
        solids.counts,
        solids.parts,
        solids.owners,
        TABLE,
        rng.random((3, *reach.shape), dtype=np.float32),
        rng.standard_normal((3, *reach.shape), dtype=np.float32),
    )
    n = len(alone)
    first = np.where(which >= 0, solids.owners[which], GROUND)
    seen = np.bincount(first[first >= 0], minlength=n)
    return Returns(
        points,
        alone,
        seen.astype(np.int64),
        np.bincount(owner[owner >= 0], minlength=n).astype(np.int64),
    )


@numba.njit(cache=True, error_model="numpy", inline="always")
def _meet_bumps(t: float, o: Float, d: Float, ground: Float, road: Float, point: Float) -> float:
    """Where a ray that meets the even ground at ``t`` (at ``point``) meets the uneven one, to first order."""
    sink = (
        (ground[1] + 2 * ground[3] * point[0]) * d[0]
        + (ground[2] + 2 * ground[3] * point[1]) * d[1]
        - d[2]
    )
    shift = 0.0
    for _ in range(MEETINGS):
        for axis in range(3):
            point[axis] = o[axis] + (t - shift) * d[axis]
        shift = min(max(bumps(point, road) / max(sink, 0.01), -FARTHEST), FARTHEST)
    return t - shift


@numba.njit(cache=True, error_model="numpy")
def _listen(
    azimuths: Float,
    elevations: Float,
    heights: Float,
    sideways: Float,
    reach: Float,
    which: Int,
    through: Int,
    ground: Float,
    road: Float,
    weakness: Float,
    planes: Float,
    counts: Int,
    parts: Float,
    owners: Int,
    table: Float,
    draws: NDArray[np.float32],
    noise: NDArray[np.float32],
) -> tuple[NDArray[np.float32], Int]:
    """Points (N, 4) and the object that each lies on."""
    n_rows, n_columns = reach.shape
    points = np.empty((n_rows * n_columns, 4), dtype=np.float32)
    owner = np.empty(n_rows * n_columns, dtype=np.int64)
    n = 0
    cos_az, sin_az = np.cos(azimuths), np.sin(azimuths)
    cos_el, sin_el = np.cos(elevations), np.sin(elevations)
    o, d, point = np.zeros(3), np.zeros(3), np.zeros(3)
    for row in range(n_rows):
        for column in range(n_columns):
            t = reach[row, column]
            if t < MIN_RANGE or t > MAX_RANGE or is_blind(row, azimuths[row, column]):
                continue
            ray(row, column, cos_az, sin_az, cos_el, sin_el, heights, sideways, o, d)
            s = which[row, column]
            rise = 0.0
            for axis in range(3):
                point[axis] = o[axis] + t * d[axis]
            if s < 0:
                reflectance, gloss, loss, dark = GROUND_REFLECTANCE, 0.0, 0.002, 0.0
                cosine = abs(d[2] - ground[1] * d[0] - ground[2] * d[1])
                if road[9] > 0:
                    t = _meet_bumps(t, o, d, ground, road, point)
                else:
                    rise = bumps(point, road)
            else:
                material = int(parts[s, MATERIAL])
                reflectance, dark = parts[s, REFLECTANCE], table[material, DARK]
                gloss, loss = table[material, GLOSS], table[material, LOSS]
                cosine = 0.7
                if table[material, DENSITY] == 0:
                    nx, ny, nz = normal_at(planes[s], counts[s], through[row, column], point)
                    cosine = abs(nx * d[0] + ny * d[1] + nz * d[2])
            power = reflectance * ((1 - gloss) * cosine + gloss * cosine**4) / (t * t)
            if draws[0, row, column] < loss or power < -FAINT * np.log(1 - draws[1, row, column]):
                continue
            far = t + RANGE_NOISE * (1 - QUIETER * road[9]) * (1 + t / 40) * noise[0, row, column]
            if column + 1 < n_columns:
                step = reach[row, column + 1] - t
                if 0.1 < abs(step) < EDGE and s >= 0 and draws[2, row, column] < MIXED:
                    far += step * draws[2, row, column] / MIXED
            if road[9] > 0 and far > MAX_RANGE:
                continue
            points[n, 0] = o[0] + far * d[0]
            points[n, 1] = o[1] + far * d[1]
            points[n, 2] = o[2] + far * d[2] + rise
            strength = reflectance * (0.75 + 0.35 * cosine) * (1 + 0.22 * noise[1, row, column])
            dim = DIM * (1 + SHINY * gloss) * np.exp((0.5 + 2 * gloss) * noise[2, row, column])
            if power * weakness[row] < dim or draws[0, row, column] > 1 - dark:
                strength = 0.0
            points[n, 3] = np.float32(round(min(max(strength, 0.0), 0.99) * 100)) / np.float32(100)
            owner[n] = owners[s] if s >= 0 else GROUND
            n += 1
    return points[:n].copy(), owner[:n].copy()
