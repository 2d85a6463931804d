"""Points within a radius, and nearest points, on a CPU: what comparing all pairs finds, to the bit; compiled.

Points are single and finite. Their distances are those of torch's ``cdist``: squares along x, y and z, of which the
latter two are added before they are rounded (in doubles it does not round like that, so these stay with it).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.extending import intrinsic
from numpy.typing import NDArray

from fl3d.points.grid import SLACK, Float, Int, Squares, reached, sort_into_squares

EACH = 1.0  # squares for a point; half or twice as many are as fast


@intrinsic
def fused(_context: Any, a: Any, b: Any, c: Any) -> tuple[Any, Callable[..., Any]]:
    """``a * b + c``, rounded once."""
    return a(a, b, c), lambda _, builder, __, values: builder.fma(*values)


@numba.njit(cache=True, error_model="numpy", inline="always")
def square_of(dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Of a distance."""
    return fused(dz, dz, fused(dy, dy, dx * dx))


def limit(radius: float) -> np.float32:
    """The least square whose root is not below a radius: what is less is inside."""
    own = np.float32(radius)
    square = own * own
    while own > 0 and np.sqrt(square) >= own:
        square = np.nextafter(square, np.float32(0))
    while np.sqrt(square) < own:
        square = np.nextafter(square, np.float32(np.inf))
    return square


@numba.njit(cache=True, error_model="numpy")
def balls(points: Float, centers: Float, radius: float, limit: np.float32, count: int) -> Int:
    """As ``operators.ball_query`` of one radius, whose ``limit`` is given: (B, N, 3), (B, M, 3) -> (B, M, count)."""
    found = np.zeros((len(points), centers.shape[1], count), dtype=np.int64)
    for b in range(len(points)):
        squares, starts, order = sort_into_squares(points[b], radius, EACH)
        cloud = points[b][order]
        for m in range(centers.shape[1]):
            x, y, z = centers[b, m, 0], centers[b, m, 1], centers[b, m, 2]
            row, held = found[b, m], 0
            x0, x1, y0, y1 = reached(squares, x, y, radius * SLACK)
            for column in range(x0, x1 + 1):
                first = column * squares[4]
                for place in range(starts[first + y0], starts[first + y1 + 1]):
                    dx, dy, dz = x - cloud[place, 0], y - cloud[place, 1], z - cloud[place, 2]
                    if square_of(dx, dy, dz) < limit:
                        held = _keep_least(row, held, order[place])
            for k in range(held, count):
                row[k] = row[0]
    return found


@numba.njit(cache=True, error_model="numpy", inline="always")
def _keep_least(row: Int, held: int, value: int) -> int:
    """Put a number in its place among the least, of which ``held`` are there; how many are there now."""
    if held == len(row):
        if value > row[held - 1]:
            return held
        held -= 1
    k = held
    while k > 0 and row[k - 1] > value:
        row[k] = row[k - 1]
        k -= 1
    row[k] = value
    return held + 1


@numba.njit(cache=True, error_model="numpy")
def nearest(points: Float, known: Float, count: int) -> tuple[Float, Int, NDArray[np.bool_]]:
    """The nearest known points of each point, nearest first.

    Args:
        points: (B, N, 3).
        known: (B, M, 3), at least ``count`` of them.
        count: how many.

    Returns:
        Distances (B, N, count), indices (B, N, count), and whether two of these distances, or the last and the next,
        are equal, so that either point could come first (B, N).
    """
    n_clouds, n_points, n_known = len(points), points.shape[1], known.shape[1]
    distances = np.empty((n_clouds, n_points, count), dtype=np.float32)
    index = np.empty((n_clouds, n_points, count), dtype=np.int64)
    tied = np.zeros((n_clouds, n_points), dtype=np.bool_)
    most = min(count + 1, n_known)
    best, own = np.empty(most, dtype=np.float32), np.empty(most, dtype=np.int64)
    for b in range(n_clouds):
        squares, starts, order = sort_into_squares(known[b], 0.0, EACH)
        cloud = known[b][order]
        for n in range(n_points):
            _nearest_of_one(points[b, n], cloud, squares, starts, best, own)
            for k in range(most):
                best[k] = math.sqrt(best[k])
                tied[b, n] |= k > 0 and best[k] == best[k - 1]
            for k in range(count):
                distances[b, n, k], index[b, n, k] = best[k], order[own[k]]
    return distances, index, tied


@numba.njit(cache=True, error_model="numpy")
def _nearest_of_one(
    point: Float, cloud: Float, squares: Squares, starts: Int, best: Float, own: Int
) -> None:
    """Fill in the least squared distances, rising, and whose: of rings that hold enough, then of their reach."""
    best[:] = np.inf
    n_x, n_y = squares[3], squares[4]
    i, _, j, _ = reached(squares, point[0], point[1], 0.0)
    a0, a1, b0, b1 = i, i, j, j
    ring = 0
    while _held(starts, n_y, a0, a1, b0, b1) < len(best):
        ring += 1
        a0, a1 = max(i - ring, 0), min(i + ring, n_x - 1)
        b0, b1 = max(j - ring, 0), min(j + ring, n_y - 1)
    for column in range(a0 * n_y, (a1 + 1) * n_y, n_y):
        _look(point, cloud, starts[column + b0], starts[column + b1 + 1], best, own)
    reach = math.sqrt(np.float64(best[-1])) * SLACK
    c0, c1, d0, d1 = reached(squares, point[0], point[1], reach)
    for x in range(c0, c1 + 1):
        column = x * n_y
        if x < a0 or x > a1:
            _look(point, cloud, starts[column + d0], starts[column + d1 + 1], best, own)
            continue
        if d0 < b0:
            _look(point, cloud, starts[column + d0], starts[column + b0], best, own)
        if d1 > b1:
            _look(point, cloud, starts[column + b1 + 1], starts[column + d1 + 1], best, own)


@numba.njit(cache=True, error_model="numpy", inline="always")
def _held(starts: Int, n_y: int, x0: int, x1: int, y0: int, y1: int) -> int:
    """Points in the squares from x0, y0 to x1, y1."""
    held = 0
    for x in range(x0, x1 + 1):
        held += starts[x * n_y + y1 + 1] - starts[x * n_y + y0]
    return held


@numba.njit(cache=True, error_model="numpy", inline="always")
def _look(point: Float, cloud: Float, start: int, end: int, best: Float, own: Int) -> None:
    """Let some points of a cloud enter the nearest."""
    for place in range(start, end):
        square = square_of(
            point[0] - cloud[place, 0], point[1] - cloud[place, 1], point[2] - cloud[place, 2]
        )
        k = len(best) - 1
        if square < best[k]:
            while k > 0 and best[k - 1] > square:
                best[k], own[k] = best[k - 1], own[k - 1]
                k -= 1
            best[k], own[k] = square, place
