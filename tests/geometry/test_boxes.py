"""Boxes: corners, folding and the way back from corners to boxes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fl3d.geometry.boxes import (
    boxes_from_corners,
    corners_velo,
    count_points_inside,
    fold,
    points_inside,
    rectangles_cam,
    standup,
    wrap,
)

angles = st.floats(-20, 20)


def test_corners_of_a_box_along_x_stand_in_the_documented_order() -> None:
    corners = corners_velo(np.array([[10.0, 5.0, -1.0, 1.5, 2.0, 4.0, 0.0]]))[0]
    expected = [
        (8, 4, -1),
        (12, 4, -1),
        (8, 6, -1),
        (8, 4, 0.5),
        (8, 6, 0.5),
        (12, 6, -1),
        (12, 4, 0.5),
        (12, 6, 0.5),
    ]
    np.testing.assert_allclose(corners, expected)


def test_a_quarter_turn_takes_length_from_x_to_y() -> None:
    corners = corners_velo(np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 4.0, np.pi / 2]]))[0]
    np.testing.assert_allclose(np.ptp(corners, axis=0), [2, 4, 1])


@given(angles, st.floats(-4, 4))
def test_fold_keeps_the_box_and_lies_in_half_a_turn(angle: float, start: float) -> None:
    folded = float(fold(np.array([angle]), start)[0])
    assert start - 1e-9 <= folded <= start + np.pi + 1e-9
    assert abs(np.sin(folded - angle)) < 1e-6  # equal up to half turns


@given(angles)
def test_wrap_keeps_the_direction(angle: float) -> None:
    wrapped = float(wrap(np.array([angle]))[0])
    assert -np.pi <= wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(0.5, 3), st.floats(3.01, 8))
def test_corners_lead_back_to_their_box(yaw: float, width: float, length: float) -> None:
    box = np.array([[20.0, -7.0, -1.7, 1.5, width, length, yaw]])
    back = boxes_from_corners(corners_velo(box))
    np.testing.assert_allclose(back[:, :6], box[:, :6], atol=1e-9)
    assert np.cos(back[0, 6] - yaw) == pytest.approx(1, abs=1e-9)


def test_a_box_wider_than_long_is_turned() -> None:
    back = boxes_from_corners(corners_velo(np.array([[0.0, 0.0, 0.0, 1.0, 4.0, 2.0, 0.0]])))
    np.testing.assert_allclose(back[0, 3:], [1, 2, 4, np.pi / 2], atol=1e-9)


def test_heading_does_not_break_at_the_wrap() -> None:
    """An arithmetic mean of angles near +-pi would point sideways."""
    corners = corners_velo(np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 4.0, np.pi - 0.01]]))
    corners += np.random.default_rng(0).normal(0, 0.02, corners.shape)
    yaw = boxes_from_corners(corners)[0, 6]
    assert abs(np.cos(yaw - np.pi)) > 0.99


def test_standup_hull_of_a_diagonal_square() -> None:
    hull = standup(np.array([[0.0, 0.0, 2.0, 2.0, np.pi / 4]]))[0]
    np.testing.assert_allclose(hull, [-np.sqrt(2), -np.sqrt(2), np.sqrt(2), np.sqrt(2)])


def test_camera_rectangle_turns_with_ry() -> None:
    """ry = -pi/2 points along +z, so the rectangle is long in z."""
    hull = standup(rectangles_cam(np.array([[3.0, 1.0, 9.0, 1.5, 1.6, 4.0, -np.pi / 2]])))[0]
    np.testing.assert_allclose(hull, [2.2, 7.0, 3.8, 11.0])


def test_points_are_counted_inside_a_turned_box() -> None:
    box = np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 4.0, np.pi / 2]])
    points = np.array([[0, 1.9, 0.5], [1.9, 0, 0.5], [0, 0, 1.1], [0, 0, -0.1], [0.9, -1.9, 0.9]])
    assert count_points_inside(points, box).tolist() == [2]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([np.float32, np.float64]))
def test_points_inside_boxes_are_those_that_numpy_finds(seed: int, dtype: type) -> None:
    """Point by point, to the bit: on faces too."""
    rng = np.random.default_rng(seed)
    points = rng.integers(-8, 8, (200, 4)).astype(dtype) / 4
    boxes = np.column_stack([rng.integers(-4, 4, (6, 3)) / 4, rng.integers(0, 8, (6, 3)) / 4])
    boxes = np.column_stack([boxes, rng.choice([0, np.pi / 2, 0.3, -2.0], 6)])
    for box, inside in zip(boxes, points_inside(points, boxes), strict=True):
        dx, dy, dz = (points[:, axis] - box[axis] for axis in range(3))
        along = dx * np.cos(box[6]) + dy * np.sin(box[6])
        across = dy * np.cos(box[6]) - dx * np.sin(box[6])
        expected = (np.abs(along) <= box[5] / 2) & (np.abs(across) <= box[4] / 2)
        assert np.array_equal(inside, expected & (dz >= 0) & (dz <= box[3]))
