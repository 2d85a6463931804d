"""A KITTI folder read in other ways: without a camera, with clouds of other forms; and what that does to its digest."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings, read_stage_settings
from fl3d.core.errors import ConfigError, DataError
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.frame_digests import data_digest
from fl3d.data.kitti import KittiFolder
from fl3d.sweep.identity import result_config


@pytest.fixture
def copy(simulated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(simulated, tmp_path / "copy"))


def first(root: Path) -> str:
    return KittiFolder(root).split("train")[0]


def test_a_name_of_any_digits_or_letters_is_a_frame(copy: Path) -> None:
    frame, names = first(copy), ("0000000005", "n015-2018", "1.5")
    for kind, ending in (("velodyne", "bin"), ("label_2", "txt"), ("calib", "txt")):
        folder = copy / "training" / kind
        for name in names:
            shutil.copy(folder / f"{frame}.{ending}", folder / f"{name}.{ending}")
    (copy / "ImageSets" / "mine.txt").write_text("\n".join(names))
    folder = KittiFolder(copy)
    assert folder.split("mine") == list(names)
    for name in names:
        assert len(folder.frame(name).labels) == len(folder.frame(frame).labels)


def test_without_a_camera_no_calibration_is_needed(copy: Path) -> None:
    shutil.rmtree(copy / "training" / "calib")
    folder = KittiFolder(copy, crop="none", calibration="axes")
    frame = folder.frame(first(copy))
    assert len(frame.points_velo) > 1000
    assert frame.image_size == (1242, 375)
    ids = folder.split("train")
    assert data_digest(folder, ids) != data_digest(KittiFolder(copy, "none", "axes"), ids[1:])


def test_without_a_camera_there_is_nothing_to_crop_to(simulated: Path) -> None:
    with pytest.raises(DataError, match=r"data\.calibration=axes has no camera.*data\.crop=none"):
        KittiFolder(simulated, calibration="axes")


def test_how_clouds_are_read_enters_the_digest_where_it_is_not_as_kittis(simulated: Path) -> None:
    ids = KittiFolder(simulated).split("train")
    usual = data_digest(KittiFolder(simulated), ids)
    assert data_digest(KittiFolder(simulated, cloud=CloudFormat(None, None, 1)), ids) == usual
    others = [
        KittiFolder(simulated, cloud=CloudFormat(columns=4)),
        KittiFolder(simulated, cloud=CloudFormat(dtype="float32")),
        KittiFolder(simulated, cloud=CloudFormat(reflectance_scale=255)),
        KittiFolder(simulated, image_size=(1600, 900)),
        KittiFolder(simulated, crop="none", calibration="axes"),
    ]
    digests = {data_digest(folder, ids) for folder in others}
    assert len(digests | {usual}) == 1 + len(others)


def test_a_told_size_is_that_of_frames_without_a_picture_alone(copy: Path) -> None:
    ids = KittiFolder(copy).split("train")
    (copy / "training" / "image_2").mkdir()
    Image.new("RGB", (1000, 300)).save(copy / "training" / "image_2" / f"{ids[0]}.jpg")
    folder = KittiFolder(copy, image_size=(1600, 900))
    assert [folder.image_size(i) for i in ids[:2]] == [(1000, 300), (1600, 900)]


def test_clouds_of_other_endings_are_read(copy: Path) -> None:
    frame = first(copy)
    path = KittiFolder(copy).path("velodyne", frame)
    points = np.fromfile(path, dtype="<f4").reshape(-1, 4)
    path.unlink()
    np.save(path.with_suffix(".npy"), points)
    folder = KittiFolder(copy)
    np.testing.assert_array_equal(folder.read_cloud(frame).points_velo, points)
    assert len(data_digest(folder, [frame])) == 16


def test_points_that_were_dropped_are_told(copy: Path) -> None:
    frame = first(copy)
    path = KittiFolder(copy).path("velodyne", frame)
    points = np.fromfile(path, dtype="<f4").reshape(-1, 4)
    points[:3, 0] = np.nan
    points.tofile(path)
    assert KittiFolder(copy).read_cloud(frame).dropped == 3


def test_a_folder_in_the_place_of_any_file_is_named(copy: Path) -> None:
    frame = first(copy)
    for kind in ("velodyne", "label_2", "calib"):
        path = KittiFolder(copy).path(kind, frame)
        content = path.read_bytes()
        path.unlink()
        path.mkdir()
        for read in (KittiFolder(copy).frame, lambda name: data_digest(KittiFolder(copy), [name])):
            with pytest.raises(DataError, match=f"{path.name}: is a folder, but a file is needed"):
                read(frame)
        path.rmdir()
        path.write_bytes(content)


KEYS = (
    "data.cloud.columns=5",
    "data.cloud.dtype=float64",
    "data.cloud.reflectance_scale=255",
    "data.image_size=[1600,900]",
)


@pytest.mark.parametrize("key", KEYS)
def test_a_key_of_reading_changes_a_stages_identity_where_it_is_not_as_kittis(key: str) -> None:
    usual, other = (result_config(compose_config(words)) for words in ([], [key]))
    assert usual["data"].keys() == {"crop", "calibration"}  # as before these keys were there
    assert other["data"] != usual["data"]


def test_a_stage_reads_as_its_sweep_was_told_to() -> None:
    config = compose_config(KEYS)
    for settings in (
        read_settings(config).data,
        read_stage_settings(config),
        read_stage_settings(config | {"data": result_config(config)["data"]}),
    ):
        folder = settings.folder(Path("kitti"))
        assert folder.cloud == CloudFormat(5, "float64", 255)
        assert folder.without_picture == (1600, 900)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("data.cloud.columns=2", r"data\.cloud\.columns: '2'"),
        ("data.cloud.dtype=double", r"data\.cloud\.dtype: no choice 'double'"),
        ("data.cloud.reflectance_scale=0", r"data\.cloud\.reflectance_scale: '0'"),
        ("data.image_size=[5]", r"data\.image_size: \[5\]"),
    ],
)
def test_values_that_cannot_be_name_their_key(word: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_settings(compose_config([word]))
