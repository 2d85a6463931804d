"""Points chosen one after the other on a CPU: farthest ones, those in slabs, those in boxes; compiled.

The same to the bit as what torch chooses on a GPU: each product and each sum is rounded. Coordinates are
single and finite.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.points.grid import Float, Int

LANES = 64  # points whose farthest is noted apart, so that a processor's vectors do the work; of 32 to 256 the fastest
Bool = NDArray[np.bool_]


@numba.njit(cache=True, error_model="numpy")
def farthest(points: Float, count: int) -> Int:
    """As ``operators.farthest_points``: (B, N, 3) -> (B, count)."""
    n_clouds, n_points = points.shape[:2]
    n_rows = (n_points + LANES - 1) // LANES
    chosen = np.zeros((n_clouds, count), dtype=np.int64)
    axes = np.zeros((3, n_rows, LANES), dtype=np.float32)
    nearest = np.empty((n_rows, LANES), dtype=np.float32)
    most = np.empty(LANES, dtype=np.float32)
    for cloud in range(n_clouds):
        nearest[:] = -1  # beyond the last point
        for i in range(n_points):
            nearest[i // LANES, i % LANES] = np.inf
            for axis in range(3):
                axes[axis, i // LANES, i % LANES] = points[cloud, i, axis]
        for i in range(1, count):
            last = points[cloud, chosen[cloud, i - 1]]
            _come_nearer(axes[0], axes[1], axes[2], last, nearest, most)
            chosen[cloud, i] = _first_of_most(nearest, most)
    return chosen


@numba.njit(cache=True, error_model="numpy")
def _come_nearer(x: Float, y: Float, z: Float, last: Float, nearest: Float, most: Float) -> None:
    """Squared distances to the chosen points once the last one is among them, and each lane's largest."""
    a, b, c = last[0], last[1], last[2]
    most[:] = -1
    for row in range(len(x)):
        xs, ys, zs, near = x[row], y[row], z[row], nearest[row]
        for lane in range(LANES):
            dx, dy, dz = xs[lane] - a, ys[lane] - b, zs[lane] - c
            square, before = dx * dx + dy * dy + dz * dz, near[lane]
            least = square if square < before else before
            near[lane] = least
            most[lane] = least if least > most[lane] else most[lane]


@numba.njit(cache=True, error_model="numpy")
def _first_of_most(nearest: Float, most: Float) -> int:
    """The first of the farthest points."""
    best, first = most.max(), nearest.size
    for lane in range(LANES):
        if most[lane] == best:
            row = 0
            while nearest[row, lane] != best:
                row += 1
            first = min(first, row * LANES + lane)
    return first


@numba.njit(cache=True, error_model="numpy")
def in_slabs(points: Float, places: Float, half: np.float32, count: int) -> tuple[Float, Bool]:
    """The first points of each slab, seen from its reference point; the first repeats where there are fewer.

    Args:
        points: (K, P, 3), depth first.
        places: reference points (K, L, 3), whose depths rise.
        half: a slab reaches less than so far to both sides.
        count: how many.

    Returns:
        (K, L, count, 3), of slabs without a point the very first one; and whether a slab holds any (K, L).
    """
    n_frustums, n_places = places.shape[:2]
    rows = np.empty((n_frustums, n_places, count, 3), dtype=np.float32)
    held, index = np.empty(n_places, dtype=np.int64), np.empty((n_places, count), dtype=np.int64)
    any_held = np.empty((n_frustums, n_places), dtype=np.bool_)
    for k in range(n_frustums):
        held[:], index[:, 0] = 0, 0
        for i in range(points.shape[1]):
            depth = points[k, i, 0]
            for place in range(_first_reaching(depth, places[k], half), n_places):
                if depth - places[k, place, 0] <= -half:
                    break
                if held[place] < count:
                    index[place, held[place]] = i
                    held[place] += 1
        for place in range(n_places):
            any_held[k, place] = held[place] > 0
            for j in range(count):
                i = index[place, j if j < held[place] else 0]
                for axis in range(3):
                    rows[k, place, j, axis] = points[k, i, axis] - places[k, place, axis]
    return rows, any_held


@numba.njit(cache=True, error_model="numpy", inline="always")
def _first_reaching(depth: np.float32, places: Float, half: np.float32) -> int:
    """The first slab that does not end before a depth, found by halving."""
    low, high = 0, len(places)
    while low < high:
        middle = (low + high) // 2
        if depth - places[middle, 0] < half:
            high = middle
        else:
            low = middle + 1
    return low


@numba.njit(cache=True, error_model="numpy")
def in_boxes(
    points: Float, frames: Int, center: Float, turn: Float, half: Float, count: int
) -> tuple[Int, Bool]:
    """The first points of each box, the first repeated where there are fewer, point 0 where there is none.

    Args:
        points: (B, N, 3).
        frames: whose points lie in a box (R,).
        center: of boxes (R, 3).
        turn: cosines and sines of their headings (R, 2).
        half: how far they reach along themselves, across and up (R, 3).
        count: how many.

    Returns:
        (R, count), and whether a box holds any (R,).
    """
    index = np.zeros((len(frames), count), dtype=np.int64)
    any_held = np.empty(len(frames), dtype=np.bool_)
    for r in range(len(frames)):
        cloud, held = points[frames[r]], 0
        cos, sin = turn[r, 0], turn[r, 1]
        for i in range(len(cloud)):
            x, y, z = (
                cloud[i, 0] - center[r, 0],
                cloud[i, 1] - center[r, 1],
                cloud[i, 2] - center[r, 2],
            )
            inside = abs(x * cos + y * sin) <= half[r, 0] and abs(y * cos - x * sin) <= half[r, 1]
            if inside and abs(z) <= half[r, 2]:
                index[r, held] = i
                held += 1
                if held == count:
                    break
        any_held[r] = held > 0
        index[r, held:] = index[r, 0]
    return index, any_held
