"""Voxelisation beside what one would pick instead: 20,000 points into VoxelNet's full-size grid.

    python benchmarks/input.py [--kitti FOLDER --frames FILE]

fl3d gives seven features a point (with the offsets from the voxel's mean) and voxels in rising
order; spconv's PointToVoxel (pip install spconv) gives the raw points in padded slots; torch.unique
is the plain way in PyTorch.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.told import tell
from fl3d.data.kitti import KittiFolder
from fl3d.data.splits import read_split
from fl3d.data.voxels import Grid, occupancy, voxelize

VOXELNET = Grid((0.0, -40.0, -3.0, 70.4, 40.0, 1.0), (0.2, 0.2, 0.4))
FCN3D = Grid((0.0, -40.0, -2.5, 80.0, 40.0, 1.5), (0.1, 0.1, 0.1))
MAX_POINTS, MAX_VOXELS = 35, 20_000


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path)
    parser.add_argument("--frames", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    points = cloud(arguments.kitti, arguments.frames)
    inside = points[VOXELNET.inside(points)]
    order = np.random.default_rng(0).permutation(len(inside))
    print(f"{len(inside)} points in {len(occupancy(inside, VOXELNET))} voxels")
    ways: dict[str, Callable[[], object]] = {
        "fl3d, 7 features, sorted": lambda: voxelize(inside, VOXELNET, MAX_POINTS),
        "fl3d, points taken at random": lambda: voxelize(inside, VOXELNET, MAX_POINTS, order),
        "torch.unique and index_add, 7 features": lambda: plain(torch.from_numpy(inside)),
        "fl3d, occupancy 800 x 800 x 40": lambda: occupancy(points, FCN3D),
        "numpy, occupancy 800 x 800 x 40": lambda: dense_occupancy(points),
    }
    try:
        ways["spconv PointToVoxel, 4 features"] = spconv(inside)
    except ImportError:
        print("spconv is not installed")
    taken = {name: 1e3 * seconds(way) for name, way in ways.items()}
    for name, milliseconds in taken.items():
        print(f"{name:40s} {milliseconds:7.3f} ms")
    own, cells = taken["fl3d, 7 features, sorted"], taken["fl3d, occupancy 800 x 800 x 40"]
    found = {
        "voxels ms": own,
        "torch.unique / fl3d": taken["torch.unique and index_add, 7 features"] / own,
        "cells ms": cells,
        "numpy grid / fl3d": taken["numpy, occupancy 800 x 800 x 40"] / cells,
    }
    other = taken.get("spconv PointToVoxel, 4 features")
    tell("input", found | ({} if other is None else {"spconv / fl3d": other / own}))


def cloud(kitti: Path | None, frames: Path | None) -> NDArray[np.float32]:
    """Twenty thousand points: of a real frame, or of a simulated one."""
    if kitti is not None and frames is not None:
        ids = read_split(frames)
        clouds = [KittiFolder(kitti).frame(i).points_velo for i in ids]
        return min(clouds, key=lambda c: abs(len(c) - 20_000))
    from fl3d.simulator.lidar import scan
    from fl3d.simulator.scene import random_scene

    rng = np.random.default_rng(0)
    site = random_scene(rng)
    return scan(site.solids(), len(site.things), site.ground, rng).points_velo[:20_000]


def plain(points: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """What one writes in PyTorch: no limit on points in a voxel."""
    low, size = torch.tensor(VOXELNET.low), torch.tensor(VOXELNET.voxel_size)
    index = ((points[:, :3] - low) / size).long()
    _, ny, nx = VOXELNET.shape
    keys, owner, counts = torch.unique(
        (index[:, 2] * ny + index[:, 1]) * nx + index[:, 0], return_inverse=True, return_counts=True
    )
    sums = torch.zeros(len(keys), 3).index_add_(0, owner, points[:, :3])
    rows = torch.cat([points, points[:, :3] - (sums / counts[:, None])[owner]], dim=1)
    return keys, rows, owner


def dense_occupancy(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """A new grid of floats, as 3D-FCN's input is usually made."""
    inside = points[FCN3D.inside(points)]
    index = ((inside[:, :3] - FCN3D.low) / np.array(FCN3D.voxel_size)).astype(int)
    grid = np.zeros(FCN3D.shape, dtype=np.float32)
    grid[index[:, 2], index[:, 1], index[:, 0]] = 1
    return grid


def spconv(points: NDArray[np.float32]) -> Callable[[], object]:
    """The one of spconv, on the CPU."""
    from spconv.utils import Point2VoxelCPU3d

    low, size = VOXELNET.low.tolist(), list(VOXELNET.voxel_size)
    high = list(VOXELNET.range_velo[3:])
    make = Point2VoxelCPU3d(size, [*low, *high], 4, MAX_VOXELS, MAX_POINTS)
    import cumm.tensorview as tv

    return lambda: make.point_to_voxel(tv.from_numpy(points))


def seconds(way: Callable[[], object], rounds: int = 30) -> float:
    """CPU seconds of one call, the fastest of some."""
    way()
    times = []
    for _ in range(rounds):
        started = time.process_time()
        way()
        times.append(time.process_time() - started)
    return min(times)


if __name__ == "__main__":
    main()
