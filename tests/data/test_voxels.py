"""Clouds as grids."""

import numpy as np

from fl3d.data.voxels import Grid, occupancy, voxelize

GRID = Grid((0.0, -2.0, -1.0, 4.0, 2.0, 1.0), (1.0, 1.0, 0.5))


def test_shape_is_z_y_x() -> None:
    assert GRID.shape == (4, 4, 4)
    assert Grid((0, -40, -3, 70.4, 40, 1), (0.2, 0.2, 0.4)).shape == (10, 400, 352)
    assert Grid((0, -40, -2.5, 80, 40, 1.5), (0.1, 0.1, 0.1)).shape == (40, 800, 800)


def test_points_fall_into_their_cells_and_outsiders_are_dropped() -> None:
    points = np.array(
        [[0.5, -1.5, -0.9, 0], [3.9, 1.9, 0.9, 0], [4.0, 0, 0, 0], [0, 0, 1.0, 0]], dtype=np.float32
    )
    assert occupancy(points, GRID).tolist() == [[0, 0, 0], [3, 3, 3]]


def test_only_the_first_points_of_a_voxel_are_kept_and_cells_rise() -> None:
    points = np.array(
        [[3.5, 0.5, 0.1, 9]] + [[0.1 * i, 0.5, 0.1, i] for i in range(8)], dtype=np.float32
    )
    voxels = voxelize(points, GRID, max_points=5)
    assert voxels.cells.tolist() == [[2, 2, 0], [2, 2, 3]]
    assert voxels.rows[:, 3].tolist() == [0, 1, 2, 3, 4, 9]
    assert voxels.lengths.tolist() == [5, 1]
    np.testing.assert_allclose(
        voxels.rows[:, 4], [-0.2, -0.1, 0, 0.1, 0.2, 0], atol=1e-6
    )  # x from the mean 0.2
    back = voxelize(points, GRID, 5, np.arange(9)[::-1])
    assert back.rows[:, 3].tolist() == [7, 6, 5, 4, 3, 9]


def test_grouping_is_what_plain_numpy_makes_of_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -3, -2, 0), (5, 3, 2, 1), (3000, 4)).astype(np.float32)
    voxels = voxelize(points, GRID, max_points=1000)
    inside = points[GRID.inside(points)]
    index = np.floor((inside[:, :3] - GRID.low) / np.array(GRID.voxel_size)).astype(int)[:, ::-1]
    cells, owner = np.unique(index, axis=0, return_inverse=True)
    assert np.array_equal(voxels.cells, cells)
    assert np.array_equal(occupancy(points, GRID), cells)
    assert np.array_equal(voxels.lengths, np.bincount(owner.ravel()))
    for voxel in range(len(cells)):
        own = inside[owner.ravel() == voxel]
        rows = voxels.rows[voxels.lengths[:voxel].sum() :][: len(own)]
        assert np.array_equal(rows[:, :4], own)
        np.testing.assert_allclose(rows[:, 4:], own[:, :3] - own[:, :3].mean(axis=0), atol=1e-5)
    again = voxelize(
        points[:10], GRID, max_points=1000
    )  # nothing of the call before is left in the table
    assert again.lengths.sum() == GRID.inside(points[:10]).sum()


def test_a_cloud_without_points_has_no_voxels() -> None:
    assert occupancy(np.zeros((0, 4), dtype=np.float32), GRID).shape == (0, 3)


def test_points_on_the_upper_border_and_without_a_number_are_out_of_range() -> None:
    low, high = np.array(GRID.range_velo[:3]), np.array(GRID.range_velo[3:])
    points = np.stack([low, high, (low + high) / 2, np.full(3, np.nan)]).astype(np.float32)
    points = np.column_stack([points, [1, 2, 3, 4]]).astype(np.float32)
    assert GRID.inside(points).tolist() == [True, False, True, False]
    assert GRID.cropped(points)[:, 3].tolist() == [1, 3]
