"""What of a label or result file is read, and what is refused: the same for training, evaluation and prediction."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import DataError
from fl3d.data.calibration import MEAN
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame
from fl3d.data.label_table import LabelTable, read_table, table_from_labels
from fl3d.data.labels import check_sizes, read_labels, write_labels

LINE = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62"
BOM = b"\xef\xbb\xbf"
Read = Callable[[bytes], LabelTable]


def by_label(folder: Path, scored: bool) -> LabelTable:
    return table_from_labels([read_labels(folder / "a.txt", scored)])


def by_table(folder: Path, scored: bool) -> LabelTable:
    return read_table(folder, ["a"], scored)


@pytest.mark.parametrize("name", ["Car\u00a0", "\u200bcar", "CAR\ufeff"])
def test_what_is_not_seen_around_a_class_is_no_part_of_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.txt").write_text(LINE.replace("Car", name), encoding="utf-8")
    assert by_table(tmp_path, False).types.tolist() == [0]
    assert read_labels(tmp_path / "a.txt").types.tolist() == ["Car"]


@pytest.fixture(params=[by_label, by_table])
def read(request: pytest.FixtureRequest, tmp_path: Path) -> Read:
    """The content of a label file as a table, by either way."""

    def of(content: bytes) -> LabelTable:
        (tmp_path / "a.txt").write_bytes(content)
        return request.param(tmp_path, False)

    return of


@pytest.fixture(params=[by_label, by_table])
def read_results(request: pytest.FixtureRequest, tmp_path: Path) -> Read:
    """The content of a result file as a table, by either way."""

    def of(content: bytes) -> LabelTable:
        (tmp_path / "a.txt").write_bytes(content)
        return request.param(tmp_path, True)

    return of


@pytest.mark.parametrize(
    "content",
    [
        f"{LINE}\n{LINE}\n".encode(),
        BOM + f"{LINE}\n{LINE}\n".encode(),
        BOM + f"{LINE}\r\n{LINE}".encode(),
        f"{LINE}\r{LINE}\r".encode(),
        f"\n  {LINE}\t\n \n\t{LINE}  ".encode(),
        LINE.replace(" ", "\t").encode() + b"\n" + LINE.encode(),
    ],
    ids=["plain", "bom", "bom-crlf", "cr", "blanks", "tabs"],
)
def test_marks_and_line_ends_change_nothing(read: Read, content: bytes) -> None:
    table = read(content)
    assert table.types.tolist() == [0, 0]
    numbers = [float(v) for v in LINE.split()[1:]]
    assert table.values.tolist() == [[*numbers, 0], [*numbers, 0]]


def test_each_file_may_begin_with_a_mark(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / f"{name}.txt").write_bytes(BOM + LINE.encode() + b" 0.5")
    assert read_table(tmp_path, ["a", "b"], scored=True).offsets.tolist() == [0, 1, 2]


@pytest.mark.parametrize("spelled", ["Car", "car", "CAR", "cAr"])
def test_kittis_classes_are_read_in_any_case_as_kitti_spells_them(
    tmp_path: Path, spelled: str
) -> None:
    (tmp_path / "a.txt").write_text(
        LINE.replace("Car", spelled) + "\n" + LINE.replace("Car", "person_SITTING")
    )
    assert read_labels(tmp_path / "a.txt").types.tolist() == ["Car", "Person_sitting"]


def test_other_classes_stay_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(
        "\n".join(LINE.replace("Car", name) for name in ("Cars", "vehicle.car", "小汽车", "0"))
    )
    assert read_labels(tmp_path / "a.txt").types.tolist() == ["Cars", "vehicle.car", "小汽车", "0"]


@pytest.mark.parametrize("more", ["", " 0.9", " 0.9 17", " 3 0.5 word nan"])
def test_further_columns_of_labels_are_left_out(read: Read, more: str) -> None:
    table = read((LINE + more).encode())
    assert table.values.tolist() == [[*(float(v) for v in LINE.split()[1:]), 0]]


@pytest.mark.parametrize("more", [" 0.9", " 0.9 17", " 0.9 17 word"])
def test_further_columns_of_results_are_left_out(read_results: Read, more: str) -> None:
    assert read_results((LINE + more).encode()).scores.tolist() == [0.9]


def test_results_need_a_score(read_results: Read) -> None:
    with pytest.raises(DataError, match=r"a\.txt:1: 16 fields expected, found 15"):
        read_results(LINE.encode())


@pytest.mark.parametrize(
    ("truncated", "occluded", "kept"),
    [
        ("0.00", "4", [0, 4]),
        ("2", "3", [2, 3]),
        ("-1", "-1", [-1, -1]),
        ("-1.00", "-1.00", [-1, -1]),
        ("0.5", "1.9", [0.5, 1]),
        ("0.5", "1e30", [0.5, 1e9]),
    ],
)
def test_what_kitti_has_not_in_truncation_and_occlusion_is_kept(
    read: Read, truncated: str, occluded: str, kept: list[float]
) -> None:
    table = read(LINE.replace("0.00 0", f"{truncated} {occluded}").encode())
    assert table.values[0, :2].tolist() == kept


def test_a_row_of_kitti_tracking_is_named(read: Read, read_results: Read) -> None:
    for of, row in (
        (read, f"0 2 {LINE}"),
        (read, f"17 -1 {LINE}"),
        (read_results, f"0 2 {LINE} 1"),
    ):
        with pytest.raises(DataError, match=r"a\.txt:2: is a row of KITTI tracking \(frame, track"):
            of(f"\n{row}\n".encode())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (LINE.encode("utf-16"), "a.txt: is not a text file of UTF-8 but of UTF-16"),
        (LINE.encode("utf-16-le"), "a.txt: is not a text file (a zero at byte 1; UTF-16?)"),
        (LINE.replace("Car", "Fußgänger").encode("latin-1"), "a.txt: is not a text file of UTF-8"),
    ],
)
def test_other_encodings_are_named(read: Read, content: bytes, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        read(content)


@pytest.mark.parametrize("way", [by_label, by_table])
def test_a_folder_in_a_files_place_is_named(
    tmp_path: Path, way: Callable[[Path, bool], LabelTable]
) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(DataError, match=r"a\.txt: is a folder, but a file is needed"):
        way(tmp_path, False)


def test_only_objects_that_are_trained_on_need_a_size(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"\n{LINE}\n{LINE.replace('Car 0.00', 'Sign 0.00').replace('1.73', '0')}\n")
    labels = read_labels(path)
    check_sizes(labels, ("Car",), path)
    with pytest.raises(DataError, match=r"a\.txt:3: field 'height, width, length' of a Sign must"):
        check_sizes(labels, ("Sign",), path)


def test_targets_name_a_car_without_a_size(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"{LINE.replace('Car', 'Van')}\n{LINE.replace('1.57', '-1.57')}\n")
    points = np.zeros((1, 4), dtype=np.float32)
    frame = Frame("a", points, MEAN, read_labels(path), (1242, 375), label_file=path)
    with pytest.raises(DataError, match=r"a\.txt:2: field 'height, width, length' of a Car"):
        TargetRule().boxes_velo(frame)
    assert len(TargetRule(("van",), min_points=0).boxes_velo(frame)) == 1


def test_strict_kitti_is_written_whatever_was_read(tmp_path: Path) -> None:
    path, copy = tmp_path / "a.txt", tmp_path / "b.txt"
    rows = ("car -1 -1", "CYCLIST 2 4", "Lkw 0.50 1", "dontcare -1 -1", "小汽车 0.00 9")
    path.write_text("\n".join(LINE.replace("Car 0.00 0", row) + " 0.5 7" for row in rows))
    write_labels(copy, read_labels(path))
    assert [line.split()[:3] for line in copy.read_text().splitlines()] == [
        ["Car", "0.00", "0"],
        ["Cyclist", "1.00", "3"],
        ["Lkw", "0.50", "1"],
        ["DontCare", "-1.00", "-1"],
        ["小汽车", "0.00", "3"],
    ]
    assert {len(line.split()) for line in copy.read_text().splitlines()} == {15}
