"""Noise that depends on nothing but place and key, so that the order of work does not matter."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy", inline="always")
def chance(key: int, first: int, second: int) -> float:
    """A number in 0..1 that depends on nothing but the arguments."""
    x = np.uint64(key) ^ (np.uint64(first) * np.uint64(0x9E3779B97F4A7C15))
    x ^= np.uint64(second) * np.uint64(0xC2B2AE3D27D4EB4F)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return float(x >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, error_model="numpy", inline="always")
def patch_noise(key: int, solid: int, point: Float, size: float) -> float:
    """-1..1, the same all over a patch of a surface."""
    i, j = int(np.floor(point[0] / size)), int(np.floor(point[1] / size))
    k = int(np.floor(point[2] / size))
    return 2 * chance(key, (i * 4096 + j) * 4096 + k, solid) - 1


@numba.njit(cache=True, error_model="numpy")
def smooth_noise(x: float, y: float, size: float) -> float:
    """-1..1, changing smoothly over ``size`` metres."""
    i, j = int(np.floor(x / size)), int(np.floor(y / size))
    u, v = x / size - i, y / size - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    a, b = chance(1, i + 8192, j + 8192), chance(1, i + 8193, j + 8192)
    c, d = chance(1, i + 8192, j + 8193), chance(1, i + 8193, j + 8193)
    return 2 * ((a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v) - 1
