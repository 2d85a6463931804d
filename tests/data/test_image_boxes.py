"""Boxes of a 2D detector: paths and classes of every spelling."""

from pathlib import Path

import pytest

from fl3d.core.errors import DataError
from fl3d.data.image_boxes import FILES, FOLDER, read_image_boxes

BOX = "0.5 1 2 3 4"


def write(root: Path, text: str) -> Path:
    (root / FOLDER).mkdir(exist_ok=True)
    (root / FOLDER / FILES[0]).write_text(text, encoding="utf-8-sig")
    return root


@pytest.mark.parametrize(
    "path",
    [
        "training/image_2/000007.png",
        "training\\image_2\\000007.png",
        "C:\\my data\\image_2\\000007.PNG",
        "/a b/000007.jpeg",
        "000007",
    ],
)
def test_the_frame_is_found_in_any_path(tmp_path: Path, path: str) -> None:
    found = read_image_boxes(write(tmp_path, f"{path} 2 {BOX}\n"), "Car")
    assert found is not None
    assert {frame: boxes.tolist() for frame, boxes in found.items()} == {
        "000007": [[1, 2, 3, 4, 0.5]]
    }


@pytest.mark.parametrize("kind", ["2", "Car", "car", "CAR"])
def test_a_class_is_a_number_or_a_name(tmp_path: Path, kind: str) -> None:
    root = write(tmp_path, f"a.png {kind} {BOX}\na.png 1 {BOX}\na.png Van {BOX}\na.png 3 {BOX}\n")
    found = read_image_boxes(root, "Car")
    assert found is not None
    assert len(found["a"]) == 1


@pytest.mark.parametrize("kind", ["4", "0", "Vehicle"])
def test_a_class_that_is_neither_is_named(tmp_path: Path, kind: str) -> None:
    with pytest.raises(
        DataError, match=r"\.txt:1: a box needs a path, a class \(1, 2, 3 or KITTI's"
    ):
        read_image_boxes(write(tmp_path, f"a.png {kind} {BOX}\n"), "Car")


def test_an_empty_file_has_no_boxes_and_no_file_is_none(tmp_path: Path) -> None:
    assert read_image_boxes(tmp_path, "Car") is None
    assert read_image_boxes(write(tmp_path, ""), "Car") == {}


def test_a_folder_in_its_place_is_named(tmp_path: Path) -> None:
    (tmp_path / FOLDER / FILES[0]).mkdir(parents=True)
    with pytest.raises(DataError, match=r"rgb_detection_train\.txt: is a folder"):
        read_image_boxes(tmp_path, "Car")
