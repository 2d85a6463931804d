"""Clouds as grids."""

import numpy as np

from fl3d.data.voxels import Grid, occupancy, voxelize

GRID = Grid((0.0, -2.0, -1.0, 4.0, 2.0, 1.0), (1.0, 1.0, 0.5))


def test_shape_is_z_y_x() -> None:
    assert GRID.shape == (4, 4, 4)
    assert Grid((0, -40, -3, 70.4, 40, 1), (0.2, 0.2, 0.4)).shape == (10, 400, 352)
    assert Grid((0, -40, -2.5, 80, 40, 1.5), (0.1, 0.1, 0.1)).shape == (40, 800, 800)


def test_points_fall_into_their_cells_and_outsiders_are_dropped() -> None:
    points = np.array([[0.5, -1.5, -0.9, 0], [3.9, 1.9, 0.9, 0], [4.0, 0, 0, 0], [0, 0, 1.0, 0]], dtype=np.float32)
    assert occupancy(points, GRID).tolist() == [[0, 0, 0], [3, 3, 3]]


def test_only_the_first_points_of_a_voxel_are_kept() -> None:
    points = np.array([[0.1 * i, 0.5, 0.1, i] for i in range(8)] + [[3.5, 0.5, 0.1, 9]], dtype=np.float32)
    voxels = voxelize(points, GRID, max_points=5)
    assert voxels.points[:, 3].tolist() == [0, 1, 2, 3, 4, 9]
    assert voxels.owner.tolist() == [0, 0, 0, 0, 0, 1]


def test_a_cloud_without_points_has_no_voxels() -> None:
    assert occupancy(np.zeros((0, 4), dtype=np.float32), GRID).shape == (0, 3)
