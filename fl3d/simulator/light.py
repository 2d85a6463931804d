"""Sun, shadows, sky and colours of a picture."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.simulator.materials import DENSITY, GLASS, PATCH, ROUGH
from fl3d.simulator.noise import chance, smooth_noise
from fl3d.simulator.solids import MATERIAL, RED, Float, enter_solid, normal_at

AMBIENT = 0.5
SHADOW_CELL, SHADOW_REACH, SHADOW_SIDE = (
    0.2,
    60.0,
    30.0,
)  # metres: shadows are drawn on the ground this far
GLASS_NUMBER = GLASS.number


@numba.njit(cache=True, error_model="numpy")
def cast_shadows(
    planes: Float,
    counts: NDArray[np.int64],
    corners: Float,
    parts: Float,
    ground: Float,
    sun: Float,
    table: Float,
) -> NDArray[np.uint8]:
    """Cells of the ground that the sun does not reach: (along, across)."""
    rows, columns = int(SHADOW_REACH / SHADOW_CELL), int(2 * SHADOW_SIDE / SHADOW_CELL)
    dark = np.zeros((rows, columns), dtype=np.uint8)
    o = np.zeros(3)
    for s in range(len(counts)):
        x0, x1, y0, y1 = 1e9, -1e9, 1e9, -1e9
        for k in range(corners.shape[1]):
            x, y, z = corners[s, k]
            t = (z - ground[0] - ground[1] * x - ground[2] * y) / sun[2]
            x0, x1 = min(x0, x, x - t * sun[0]), max(x1, x, x - t * sun[0])
            y0, y1 = min(y0, y, y - t * sun[1]), max(y1, y, y - t * sun[1])
        first, last = max(0, int(x0 / SHADOW_CELL)), min(rows, int(x1 / SHADOW_CELL) + 1)
        left, right = (
            max(0, int((y0 + SHADOW_SIDE) / SHADOW_CELL)),
            min(columns, int((y1 + SHADOW_SIDE) / SHADOW_CELL) + 1),
        )
        density = table[int(parts[s, MATERIAL]), DENSITY]
        for i in range(first, last):
            for j in range(left, right):
                if dark[i, j]:
                    continue
                o[0], o[1] = (i + 0.5) * SHADOW_CELL, (j + 0.5) * SHADOW_CELL - SHADOW_SIDE
                o[2] = (
                    ground[0]
                    + ground[1] * o[0]
                    + ground[2] * o[1]
                    + ground[3] * (o[0] ** 2 + o[1] ** 2)
                )
                enter, leave, _ = enter_solid(planes[s], counts[s], o, sun)
                if enter < leave and leave > 0.05:
                    dark[i, j] = 0 if density > 0 and chance(3, i * columns + j, s) > 0.75 else 1
    return dark


@numba.njit(cache=True, error_model="numpy", inline="always")
def speckle(point: Float, s: int) -> float:
    """0..1, changing every few centimetres: leaves."""
    i, j, k = int(np.floor(point[0] * 9)), int(np.floor(point[1] * 9)), int(np.floor(point[2] * 9))
    return chance(7, (i * 2048 + j) * 2048 + k, s)


@numba.njit(cache=True, error_model="numpy")
def sky_color(d: Float, color: Float) -> None:
    """Fill in the colour of the sky in a direction."""
    up = max(0.0, d[2] / np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2))
    clouds = 0.5 + 0.5 * smooth_noise(30 * d[1] / d[0], 120 * up, 4.0)
    blue = min(1.0, 4 * up) * (1 - 0.6 * clouds)
    color[0], color[1], color[2] = 0.92 - 0.5 * blue, 0.94 - 0.3 * blue, 0.97 - 0.05 * blue


@numba.njit(cache=True, error_model="numpy")
def ground_color(
    point: Float, road: Float, shadows: NDArray[np.uint8], land: Float, sun: Float, color: Float
) -> None:
    """Fill in the colour of a point on the ground: asphalt with its lines, paving or grass."""
    across = point[1] - road[0] - road[1] * point[0] - road[2] * point[0] * point[0]
    # grains of a finger's width near the camera, of a hand's far away: finer ones would only flicker
    size = 0.05 if point[0] < 12 else 0.25
    x, y = point[0] + road[7], point[1] + road[8]
    speck = chance(11, int(np.floor(x / size)), int(np.floor(y / size)) + 4096)
    grain = 0.07 * (speck - 0.5) + 0.05 * smooth_noise(x, y, 1.7)
    if road[4] <= across <= road[3]:
        base = 0.4
        middle = abs(across - (road[3] + road[4]) / 2) < 0.07 and point[0] % 9.0 < 4.0
        line = middle or abs(across - road[3] + 0.3) < 0.06 or abs(across - road[4] - 0.3) < 0.06
        for k in range(3):
            color[k] = 0.8 if line else base + grain
    else:
        kind = 0 if road[6] > 0.05 else 1
        for k in range(3):
            color[k] = land[kind, k] * (1 + 2.5 * grain)
    light = AMBIENT + (1 - AMBIENT) * sun[2] * 1.2
    i, j = int(point[0] / SHADOW_CELL), int((point[1] + SHADOW_SIDE) / SHADOW_CELL)
    if 0 <= i < shadows.shape[0] and 0 <= j < shadows.shape[1] and shadows[i, j]:
        light = AMBIENT * 0.85
    for k in range(3):
        color[k] *= light


@numba.njit(cache=True, error_model="numpy")
def solid_color(
    point: Float,
    s: int,
    planes: Float,
    count: int,
    through: int,
    part: Float,
    table: Float,
    sun: Float,
    d: Float,
    color: Float,
) -> None:
    """Fill in the colour of a point on a solid."""
    nx, ny, nz = normal_at(planes, count, through, point)
    material = int(part[MATERIAL])
    light = (
        AMBIENT * (0.8 + 0.2 * nz)
        + (1 - AMBIENT) * max(0.0, nx * sun[0] + ny * sun[1] + nz * sun[2]) * 1.2
    )
    if table[material, DENSITY] > 0:
        light *= 0.65 + 0.6 * speckle(point, s + 1)
    elif table[material, ROUGH] > 0:
        size = table[material, PATCH]
        cell = (int(np.floor(point[0] / size)) * 4096 + int(np.floor(point[1] / size))) * 4096
        light *= 0.9 + 0.2 * chance(9, cell + int(np.floor(point[2] / size)), s)
    for k in range(3):
        color[k] = part[RED + k] * light
    if material == GLASS_NUMBER:  # the sky in it
        shine = 0.05 + 0.25 * max(0.0, nz) ** 2
        for k in range(3):
            color[k] = color[k] * (1 - shine) + (0.75 + 0.05 * k) * shine
