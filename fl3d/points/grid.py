"""Points of a cloud sorted into squares of the ground, so that neighbours are looked for nearby alone; compiled.

Squares, not cubes: a LiDAR's points are spread wide and not high. What lies in reach is told by the squares' numbers
alone, which rise with a coordinate whatever the rounding: no point is missed.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Int = NDArray[np.int64]
Squares = tuple[
    float, float, float, int, int
]  # least x and y, squares a metre, squares along x and y
SLACK = 1 + 1e-4  # of a reach: far more than single numbers round


@numba.njit(cache=True, error_model="numpy")
def sort_into_squares(cloud: Float, least: float, each: float) -> tuple[Squares, Int, Int]:
    """Lay squares over a cloud.

    Args:
        cloud: (N, 3), finite.
        least: length of a square at least, metres.
        each: squares for each point at most.

    Returns:
        The squares; where each one's points start among all (squares + 1,); the points by square, rising in each (N,).
    """
    x0, y0, x1, y1 = cloud[0, 0], cloud[0, 1], cloud[0, 0], cloud[0, 1]
    for i in range(len(cloud)):
        x0, x1 = min(x0, cloud[i, 0]), max(x1, cloud[i, 0])
        y0, y1 = min(y0, cloud[i, 1]), max(y1, cloud[i, 1])
    low_x, low_y = np.float64(x0), np.float64(y0)
    wide, deep = np.float64(x1) - low_x, np.float64(y1) - low_y
    most = each * len(cloud)
    length = max(least, math.sqrt(wide * deep / most), (wide + deep) / most, 1e-9)
    squares = (
        low_x,
        low_y,
        1 / length,
        int(wide / length) + 1,
        int(deep / length) + 1,
    )
    starts = np.zeros(squares[3] * squares[4] + 1, dtype=np.int64)
    own = np.empty(len(cloud), dtype=np.int64)
    for i in range(len(cloud)):
        x = square(cloud[i, 0], low_x, squares[2], squares[3])
        own[i] = x * squares[4] + square(cloud[i, 1], low_y, squares[2], squares[4])
        starts[own[i] + 1] += 1
    for place in range(1, len(starts)):
        starts[place] += starts[place - 1]
    order, taken = np.empty(len(cloud), dtype=np.int64), starts[:-1].copy()
    for i in range(len(cloud)):
        order[taken[own[i]]] = i
        taken[own[i]] += 1
    return squares, starts, order


@numba.njit(cache=True, error_model="numpy", inline="always")
def square(place: float, low: float, scale: float, count: int) -> int:
    """Number of a square along one axis; beyond the cloud the first or the last."""
    return int(min(max((place - low) * scale, 0.0), count - 1.0))


@numba.njit(cache=True, error_model="numpy", inline="always")
def reached(squares: Squares, x: float, y: float, reach: float) -> tuple[int, int, int, int]:
    """First and last squares along x and along y that a circle meets."""
    low_x, low_y, scale, n_x, n_y = squares
    return (
        square(x - reach, low_x, scale, n_x),
        square(x + reach, low_x, scale, n_x),
        square(y - reach, low_y, scale, n_y),
        square(y + reach, low_y, scale, n_y),
    )
