"""Calibrations of objects, tracking and raw drives, and what cannot be one."""

import re
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import DataError
from fl3d.data.calibration import AXES, MEAN
from fl3d.data.calibration_files import read_calibration, write_calibration
from fl3d.data.pictures import size_without_picture

P2 = "700 0 600 45 0 700 180 0.2 0 0 1 0.003"
R0 = "1 0 0 0 1 0 0 0 1"
TR = "0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3"
UNIT = " 0 0 0 1"


def row(values: str, *places: int) -> str:
    """Zeros put in behind each three values."""
    words = values.split()
    return " ".join(" ".join([*words[k : k + 3], "0"]) for k in places)


def text(**rows: str) -> str:
    return "".join(f"{name}: {values}\n" for name, values in rows.items())


def read(folder: Path, content: str) -> tuple[list[float], list[float], list[float]]:
    path = folder / "000000.txt"
    path.write_bytes(content.encode())
    found = read_calibration(path)
    return (
        found.P2.ravel().tolist(),
        found.R0_rect.ravel().tolist(),
        found.Tr_velo_to_cam.ravel().tolist(),
    )


PLAIN = tuple([float(v) for v in values.split()] for values in (P2, R0, TR))


@pytest.mark.parametrize(
    "content",
    [
        text(P0=P2, P2=P2, R0_rect=R0, Tr_velo_to_cam=TR, Tr_imu_to_velo=TR),
        "\ufeff" + text(P2=P2, R0_rect=R0, Tr_velo_to_cam=TR).replace("\n", "\r\n"),
        text(p2=P2, R0_RECT=R0, tr_velo_TO_cam=TR),
        f"P2: {P2}\nR_rect {R0}\nTr_velo_cam {TR}\nTr_imu_velo {TR}\n",
        f"P2 :{P2}\nR0_rect:{R0}\n  Tr_velo_to_cam\t: {TR}\n",
        text(calib_time="09-Jan-2012 13:57:47", P_rect_02=P2, R_rect_00=R0, R="0 -1 0 0 0 -1 1 0 0")
        + text(T="0.1 0.2 0.3", delta_f="0 0"),
        text(P2=P2 + UNIT, R0_rect=row(R0, 0, 3, 6) + UNIT, Tr_velo_to_cam=TR + UNIT),
        text(P2=P2, R0_rect=row(R0, 0, 3, 6), Tr_velo_to_cam=TR),
        f"# a comment: P2 is below\n\nP2: {P2}\nnot a matrix\nR0_rect: {R0}\nTr_velo_to_cam: {TR}",
    ],
    ids=["objects", "bom", "case", "tracking", "colons", "raw", "4x4", "3x4", "comments"],
)
def test_the_same_calibration_in_all_its_spellings(tmp_path: Path, content: str) -> None:
    assert read(tmp_path, content) == PLAIN


def test_a_camera_of_three_columns_has_no_shift(tmp_path: Path) -> None:
    camera = "700 0 600 0 700 180 0 0 1"
    found, _, _ = read(tmp_path, text(P2=camera, R0_rect=R0, Tr_velo_to_cam=TR))
    assert found == [700, 0, 600, 0, 0, 700, 180, 0, 0, 0, 1, 0]


def whole(**rows: str) -> str:
    return text(**{"P2": P2, "R0_rect": R0, "Tr_velo_to_cam": TR} | rows)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (whole() + f"P2: {P2}\n", "000000.txt:4: P2 is given twice: P2 stands in line 1 already"),
        (whole() + f"P_rect_02 {P2}\n", ":4: P_rect_02 is given twice: P2 stands in line 1 alrea"),
        (text(P2=P2, Tr_velo2cam=TR), "no line for R0_rect, Tr_velo_to_cam (found: P2, Tr_velo2cam; "
         "did you mean Tr_velo2cam?)"),
        (text(P2=P2, R0_rect=R0, R=R0), "no line for Tr_velo_to_cam (found: P2, R0_rect, R)"),
        ("", "no line for P2, R0_rect, Tr_velo_to_cam (found: nothing)"),
        (whole(P2=P2[4:]), ":1: P2 needs 12 values (16 or 9 will do), found 11"),
        (whole(R0_rect=R0 + " 0"), ":2: R0_rect needs 9 values (12 or 16 will do), found 10"),
        (whole(P2=P2.replace("45", "4_5")), ":1: field 'P2': '4_5' is not a number"),
        (whole(P2=P2.replace("45", "nan")), ":1: field 'P2': 'nan' is not finite"),
        (whole(P2=P2 + " 0 0 1 0"), ":1: P2: what is more than 3 x 4 must be as in the unit matrix"),
        (whole(R0_rect=TR), ":2: R0_rect: what is more than 3 x 3 must be as in the unit matrix"),
        (whole(P2="0 " * 12), "P2 is all zero, so it is no camera's. Without a camera: data.calibra"),
        (whole(P2="-" + P2), "P2 is no camera's: its focal lengths are -700 and 700, not above 0"),
        (whole(Tr_velo_to_cam="0 " * 12), "Tr_velo_to_cam is no rotation: its 3 x 3 is all zero"),
        (whole(R0_rect="0 " * 9), "R0_rect is no rotation: its 3 x 3 is all zero"),
        (whole(R0_rect=R0.replace("1", "2")), "R0_rect is no rotation: its 3 x 3 has rows of length "
         "2, 2, 2, not 1"),
        (whole(R0_rect=R0[:-1] + "-1"), "R0_rect is no rotation: its 3 x 3 is mirrored (determinant "),
        (whole(R0_rect="1 0 0 1 0 0 0 0 1"), "its 3 x 3 has rows that are not at right angles"),
    ],
)  # fmt: skip
def test_what_cannot_be_right_names_file_line_and_matrix(
    tmp_path: Path, content: str, message: str
) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        read(tmp_path, content)


def test_two_digits_behind_the_point_are_enough_for_a_rotation(tmp_path: Path) -> None:
    path = tmp_path / "000000.txt"
    write_calibration(path, MEAN)
    rounded = " ".join(f"{float(v):.2f}" for v in MEAN.Tr_velo_to_cam.ravel())
    assert len(read(tmp_path, whole(Tr_velo_to_cam=rounded))[2]) == 12


def test_a_folder_in_its_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=": is a folder, but a file is needed"):
        read_calibration(tmp_path)


def test_the_axes_are_the_lidars_renamed() -> None:
    ahead, left, up = np.eye(3)
    cam = AXES.points_to_cam(np.array([ahead, left, up]))
    assert cam.tolist() == [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # x right, y down, z forward
    assert AXES.points_to_image(cam[:1])[0].tolist() == [[621, 187.5]]


def test_all_real_calibrations_are_rotations_by_a_wide_margin(kitti_sample: Path) -> None:
    """And the size of their pictures is KITTI's."""
    files = sorted((kitti_sample / "training" / "calib").glob("*.txt"))
    assert len(files) == 7481
    for file in files:
        found = read_calibration(file)
        for turn in (found.R0_rect, found.Tr_velo_to_cam[:, :3]):
            assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6
        assert size_without_picture(found, file) == (1242, 375)
