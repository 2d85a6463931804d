"""Pictures of frames, and how large a frame without one is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fl3d.core.errors import ConfigError, DataError
from fl3d.data.calibration import AXES, MEAN, Calibration
from fl3d.data.pictures import (
    checked_size,
    find_picture,
    picture_size,
    read_picture,
    size_without_picture,
)

FILE = Path("calib/000000.txt")


def camera(x: float, y: float) -> Calibration:
    """KITTI's, with its middle elsewhere."""
    P2 = MEAN.P2.copy()
    P2[:2, 2] = x, y
    return replace(MEAN, P2=P2)


@pytest.mark.parametrize("ending", ["png", "PNG", "jpg", "JPG", "Jpg", "jpeg", "JPEG"])
def test_pictures_of_every_ending_are_found_and_read(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"000007.{ending}"
    Image.new("L", (30, 20), 7).save(path)
    assert find_picture(tmp_path, "000007") == path
    assert picture_size(path) == (30, 20)
    assert read_picture(path).shape == (20, 30, 3)
    assert find_picture(tmp_path, "000008") is None


def test_a_picture_is_known_by_its_content_not_its_ending(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.new("RGB", (30, 20)).save(path, format="JPEG")
    assert picture_size(path) == (30, 20)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"not a picture"])
def test_a_broken_picture_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "000000.png"
    path.write_bytes(content)
    for read in (picture_size, read_picture):
        with pytest.raises(DataError, match=r"000000\.png: is a broken picture, or none \("):
            read(path)


def test_a_picture_that_is_cut_off_is_named_where_its_pixels_are_read(tmp_path: Path) -> None:
    path = tmp_path / "000000.png"
    pixels = np.random.default_rng(0).integers(0, 255, (200, 300, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    path.write_bytes(path.read_bytes()[:50_000])
    assert picture_size(path) == (300, 200)
    with pytest.raises(DataError, match=r"000000\.png: is a broken picture"):
        read_picture(path)


def test_a_folder_in_its_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    found = find_picture(tmp_path, "a")
    assert found is not None
    with pytest.raises(DataError, match=r"a\.png: is a folder, but a file is needed"):
        picture_size(found)


@pytest.mark.parametrize(
    ("calibration", "size"),
    [
        (MEAN, (1242, 375)),
        (AXES, (1242, 375)),
        (camera(600.4, 185.2), (1242, 375)),
        (camera(960, 540), (1920, 1080)),
        (camera(816.3, 491.2), (1633, 982)),
        (camera(605, 360), (1210, 720)),
    ],
)
def test_without_a_picture_the_middle_of_the_camera_tells_the_size(
    calibration: Calibration, size: tuple[int, int]
) -> None:
    assert size_without_picture(calibration, FILE) == size


@pytest.mark.parametrize("middle", [(0, 0), (-5, 100), (600, 0.2)])
def test_a_middle_that_is_no_pictures_is_named(middle: tuple[float, float]) -> None:
    with pytest.raises(DataError, match=r"calib/000000\.txt: P2's middle is at .*data\.image_size"):
        size_without_picture(camera(*middle), FILE)


def test_the_size_that_is_told_is_two_whole_numbers() -> None:
    assert checked_size(None) is None
    assert checked_size([1600, 900]) == (1600, 900)
    for wrong in ([1600], [1600, 0], [1600.5, 900], "1600x900", [True, 5], [1, 2, 3], 5):
        with pytest.raises(ConfigError, match=r"data\.image_size: .*, such as \[1242,375\]"):
            checked_size(wrong)
