"""Point clouds as grids. Cells are indexed z, y, x; the LiDAR frame throughout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.geometry.boxes import Points


@dataclass(frozen=True)
class Grid:
    """A regular grid over a box of space.

    Args:
        range_velo: x0, y0, z0, x1, y1, z1 in metres; the upper ends are outside.
        voxel_size: edge lengths along x, y, z in metres.
    """

    range_velo: Sequence[float]
    voxel_size: Sequence[float]

    @property
    def low(self) -> NDArray[np.float64]:
        """Lower corner x, y, z."""
        return np.array(self.range_velo[:3])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells along z, y, x."""
        extent = np.array(self.range_velo[3:]) - self.low
        nx, ny, nz = np.rint(extent / self.voxel_size).astype(int)
        return int(nz), int(ny), int(nx)

    def inside(self, points_velo: Points) -> NDArray[np.bool_]:
        """Which points lie in range: (N, >=3) -> (N,)."""
        xyz = points_velo[:, :3]
        inside = (xyz >= self.low) & (xyz < np.array(self.range_velo[3:]))
        return np.asarray(inside.all(axis=1))


@dataclass(frozen=True)
class Voxels:
    """Points grouped by voxel.

    Args:
        cells: (V, 3) int64, z, y, x of each occupied voxel, in order of first point.
        points: (P, C) the points that were kept.
        owner: (P,) int64, which voxel a point belongs to.
    """

    cells: NDArray[np.int64]
    points: NDArray[np.float32]
    owner: NDArray[np.int64]


@numba.njit(cache=True)
def _group(
    points: NDArray[np.float32],
    low: NDArray[np.float64],
    size: NDArray[np.float64],
    shape: tuple[int, int, int],
    max_points: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    nz, ny, nx = shape
    voxel_of = np.full(nz * ny * nx, -1, dtype=np.int32)
    cells = np.empty((points.shape[0], 3), dtype=np.int64)
    counts = np.zeros(points.shape[0], dtype=np.int64)
    kept = np.empty(points.shape[0], dtype=np.int64)
    owner = np.empty(points.shape[0], dtype=np.int64)
    n_voxels = n_kept = 0
    for i in range(points.shape[0]):
        x = int(np.floor((points[i, 0] - low[0]) / size[0]))
        y = int(np.floor((points[i, 1] - low[1]) / size[1]))
        z = int(np.floor((points[i, 2] - low[2]) / size[2]))
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            continue
        key = (z * ny + y) * nx + x
        voxel = voxel_of[key]
        if voxel < 0:
            voxel = n_voxels
            voxel_of[key] = voxel
            cells[voxel, 0], cells[voxel, 1], cells[voxel, 2] = z, y, x
            n_voxels += 1
        if counts[voxel] < max_points:
            counts[voxel] += 1
            kept[n_kept] = i
            owner[n_kept] = voxel
            n_kept += 1
    return cells[:n_voxels].copy(), kept[:n_kept].copy(), owner[:n_kept].copy()


def voxelize(points_velo: NDArray[np.float32], grid: Grid, max_points: int) -> Voxels:
    """Group points by voxel, keeping the first ``max_points`` of each (VoxelNet's T; shuffle beforehand).

    Args:
        points_velo: (N, C), x, y, z first; points out of range are left out.
        grid: the cells.
        max_points: points kept in one voxel.
    """
    low, size = grid.low, np.array(grid.voxel_size, dtype=np.float64)
    cells, kept, owner = _group(points_velo, low, size, grid.shape, max_points)
    return Voxels(cells, points_velo[kept], owner)


def occupancy(points_velo: NDArray[np.float32], grid: Grid) -> NDArray[np.int64]:
    """Occupied cells: (V, 3) z, y, x, each once."""
    return voxelize(points_velo, grid, max_points=1).cells
