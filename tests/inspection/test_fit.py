"""Boxes in the picture and boxes in space that are not of the same objects."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fl3d.inspection.fit import _iou
from tests.inspection.test_check import change_calibrations, change_labels, look, texts

Row = list[str]


@pytest.fixture
def folder(simulated: Path, tmp_path: Path) -> Path:
    return shutil.copytree(simulated, tmp_path / "data")


def at_the_middle(row: Row) -> Row:
    """Its y where the middle of the box is: y points down, so half the height less."""
    return [*row[:12], f"{float(row[12]) - float(row[8]) / 2:.4f}", *row[13:]]


def width_and_height(row: Row) -> Row:
    x1, y1, x2, y2 = (float(value) for value in row[4:8])
    return [*row[:6], f"{x2 - x1:.2f}", f"{y2 - y1:.2f}", *row[8:]]


def yaw_of_the_lidar(row: Row) -> Row:
    return [*row[:14], f"{-float(row[14]) - np.pi / 2:.4f}", *row[15:]]


KINDS: dict[str, tuple[Callable[[Row], Row], str]] = {
    "middle": (at_the_middle, "They fit where y is the middle of the 3D boxes"),
    "width, height": (width_and_height, "They fit where the 2D boxes are x, y, width, height"),
    "yaw": (yaw_of_the_lidar, "rotation_y radians about its y axis?"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_boxes_that_do_not_fit_are_warned_of_with_the_cause(folder: Path, kind: str) -> None:
    change, expected = KINDS[kind]
    change_labels(folder, lambda row: row if row[0] == "DontCare" else change(row))
    found = [text for text in texts(look(folder), folder) if "2D boxes and projected" in text]
    assert len(found) == 1
    assert "whole, visible labels of class Car overlap (IoU) by 0." in found[0]
    assert expected in found[0]


def test_another_cameras_projection_is_warned_of(folder: Path) -> None:
    file = folder / "training" / "calib" / "000000.txt"
    rows = dict(line.split(": ") for line in file.read_text().splitlines() if ": " in line)
    change_calibrations(folder, "P2", rows["P3"])
    assert any("Is P2 that of these pictures" in text for text in texts(look(folder), folder))


def test_boxes_of_two_kinds_are_compared_only_where_both_are_there(folder: Path) -> None:
    change_labels(folder, lambda row: [*row[:4], "-1", "-1", "-1", "-1", *row[8:]])
    assert not any("projected" in text for text in texts(look(folder), folder))


def test_overlap_of_rectangles() -> None:
    one = np.array([[0.0, 0, 2, 2], [0, 0, 2, 2], [3, 3, 1, 1]])
    other = np.array([[1.0, 0, 3, 2], [4, 4, 5, 5], [0, 0, 4, 4]])
    np.testing.assert_allclose(_iou(one, other), [1 / 3, 0, 0])
