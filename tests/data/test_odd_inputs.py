"""What people really bring, each with its right value: see the README of every folder."""

from pathlib import Path

import numpy as np
import pytest

from fl3d.config.compose import compose_config
from fl3d.core.errors import DataError
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import OTHER, read_table
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.folders import result_ids
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol

FRAMES = ("000001", "000010")  # of each training folder: one to train, one to validate
TARGETS = [8, 5]  # cars that hold 10 points, in both as KITTI has them


def targets(folder: KittiFolder) -> list[int]:
    return [len(TargetRule().boxes_velo(folder.frame(frame))) for frame in FRAMES]


def ap(case: Path) -> list[float]:
    """3D AP of cars by difficulty, R40."""
    ids = result_ids(case / "res", case / "label_2")
    gt = read_table(case / "label_2", ids, scored=False)
    det = read_table(case / "res", ids, scored=True)
    protocol = Protocol(**compose_config(["protocol=kitti"])["protocol"])
    levels = evaluate(compare(gt, det, protocol))["Car"]["3d"]
    return [levels[name].ap_r40 for name in DIFFICULTIES]


@pytest.mark.parametrize("name", ["bom-labels", "bom-results"])
def test_a_byte_order_mark_loses_no_object(odd_inputs: Path, name: str) -> None:
    assert ap(odd_inputs / name) == [100, 100, 100]


@pytest.mark.parametrize("name", ["ids-7-digits", "ids-mixed-6-7-digits"])
def test_frames_of_any_number_of_digits_are_evaluated(odd_inputs: Path, name: str) -> None:
    case = odd_inputs / name
    assert len(result_ids(case / "res", case / "label_2")) == 60
    assert ap(case) == [100, 100, 100]


def test_unknown_classes_are_told(odd_inputs: Path) -> None:
    case = odd_inputs / "class-names-unknown" / "label_2"
    table = read_table(case, [path.stem for path in sorted(case.glob("*.txt"))], scored=False)
    assert table.others == ("Vehicle",)
    assert table.types.tolist() == [OTHER] * 60


def test_an_occlusion_of_4_is_read(odd_inputs: Path) -> None:
    case = odd_inputs / "occluded-4" / "label_2"
    table = read_table(case, [path.stem for path in sorted(case.glob("*.txt"))], scored=False)
    assert set(table.values[:, 1]) == {4}


@pytest.mark.parametrize("name", ["calib-4x4", "calib-tracking-names"])
def test_calibrations_of_other_spellings_are_the_same(
    odd_inputs: Path, kitti_sample: Path, name: str
) -> None:
    folder, real = KittiFolder(odd_inputs / name), KittiFolder(kitti_sample)
    for frame in FRAMES:
        found, plain = folder.read_calibration(frame), real.read_calibration(frame)
        np.testing.assert_allclose(found.P2, plain.P2)
        np.testing.assert_allclose(found.velo_to_rect, plain.velo_to_rect, atol=1e-6)
    assert targets(folder) == TARGETS


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("calib-zeros", r"calib/000001\.txt: Tr_velo_to_cam is no rotation: its 3 x 3 is all zero"),
        ("calib-identity", r"calib/000001\.txt: P2's middle is at 0, 0 pixels.*=axes"),
        (
            "cloud-5-columns",
            r"velodyne/000001\.bin: looks like 5 columns .*: give data\.cloud\.col",
        ),
        (
            "cloud-float64",
            r"looks like float64 \(\|xyz\| up to 3\.7e\+19 m\): give data\.cloud\.dty",
        ),
    ],
)
def test_what_cannot_be_right_is_named(odd_inputs: Path, name: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        KittiFolder(odd_inputs / name).frame("000001")


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("cloud-5-columns", CloudFormat(columns=5)),
        ("cloud-float64", CloudFormat(dtype="float64")),
        ("cloud-npy-named-bin", CloudFormat()),
    ],
)
def test_clouds_of_other_forms_are_kittis_when_told_or_known(
    odd_inputs: Path, name: str, form: CloudFormat
) -> None:
    folder, real = KittiFolder(odd_inputs / name, cloud=form), KittiFolder(odd_inputs / "calib-4x4")
    for frame in FRAMES:
        found, plain = folder.read_cloud(frame), real.read_cloud(frame)
        lost = len(plain.points_velo) - len(found.points_velo)
        assert (
            lost < 4
        )  # left out of the one with 5 columns, so that it is a whole number of 16 bytes
        np.testing.assert_array_equal(
            found.points_velo, plain.points_velo[: len(found.points_velo)]
        )
    assert targets(folder) == TARGETS


def test_jpg_pictures_tell_their_size(odd_inputs: Path) -> None:
    folder = KittiFolder(odd_inputs / "image-jpg-1920")
    assert [folder.image_size(frame) for frame in FRAMES] == [(1920, 1200)] * 2
    assert targets(folder) == TARGETS


def test_a_frame_twice_in_a_split_is_named(odd_inputs: Path) -> None:
    with pytest.raises(DataError, match=r"train\.txt:2: frame 000001 stands in line 1 already"):
        KittiFolder(odd_inputs / "split-duplicates").split("train")


@pytest.mark.parametrize("name", ["train-lower-case-car", "labels-nuscenes"])
def test_cars_are_targets_whatever_their_case_columns_and_occlusion(
    odd_inputs: Path, name: str
) -> None:
    assert targets(KittiFolder(odd_inputs / name)) == TARGETS


def test_empty_labels_are_read(odd_inputs: Path) -> None:
    assert targets(KittiFolder(odd_inputs / "train-all-labels-empty")) == [0, 0]
