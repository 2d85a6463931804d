"""The fast reader: exact numbers, and every malformed line named."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fl3d.core.errors import DataError
from fl3d.data.label_table import NAMES, OTHER, read_table, table_from_labels
from fl3d.data.labels import read_labels

LINE = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62"


def write(folder: Path, *texts: str) -> list[str]:
    ids = [f"{i:06d}" for i in range(len(texts))]
    for frame_id, text in zip(ids, texts, strict=True):
        (folder / f"{frame_id}.txt").write_text(text)
    return ids


def test_frames_lines_and_types(tmp_path: Path) -> None:
    ids = write(
        tmp_path, f"{LINE}\n{LINE.replace('Car', 'vAn')}\n", "", f"\n{LINE.replace('Car', 'Boat')}"
    )
    table = read_table(tmp_path, ids, scored=False)
    assert table.offsets.tolist() == [0, 2, 2, 3]
    assert table.types.tolist() == [NAMES.index("car"), NAMES.index("van"), OTHER]
    assert table.others == ("Boat",)
    assert table.frame.tolist() == [0, 0, 2]
    assert table.boxes_cam[0].tolist() == [1.00, 1.75, 13.22, 1.57, 1.73, 4.15, 1.62]


def test_names_that_kitti_lacks_are_told_in_order_of_first_appearance(tmp_path: Path) -> None:
    names = ("Vehicle", "Lkw", "car", "Vehicle", "小汽车", "Lkw")
    ids = write(tmp_path, *(LINE.replace("Car", name) for name in names))
    for table in (
        read_table(tmp_path, ids, scored=False),
        table_from_labels([read_labels(tmp_path / f"{i}.txt") for i in ids]),
    ):
        assert table.others == ("Vehicle", "Lkw", "小汽车")
        assert (table.types - OTHER).tolist() == [0, 1, NAMES.index("car") - OTHER, 0, 2, 1]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=15, max_size=15))
def test_every_number_is_read_exactly(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[float]
) -> None:
    folder = tmp_path_factory.mktemp("numbers")
    ids = write(folder, "Car " + " ".join(repr(v) for v in numbers))
    assert read_table(folder, ids, scored=True).values[0].tolist() == numbers


@pytest.mark.parametrize(
    "text",
    ["1", "-1", "+1.5", ".5", "5.", "-.25", "0001.50", "1e3", "-2.5E-4", "123456789012345678"],
)
def test_every_spelling_of_a_number_is_read(tmp_path: Path, text: str) -> None:
    ids = write(tmp_path, LINE.replace("13.22", text))
    assert read_table(tmp_path, ids, scored=False).values[0, 12] == float(text)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Car 1 2 3", "000001.txt:2: 15 fields expected, found 4"),
        ("Car 0.00 0 1e-1 614.24", "000001.txt:2: 15 fields expected, found 5"),
        (
            LINE.replace(" ", ","),
            "found 1 in 'Car,0.00,0,1.55,614.24,181.78,727.31,284...' (KITTI separates",
        ),
        (LINE.replace(" ", ";"), "(KITTI separates them by blanks)"),
        ("# by hand", "found 3 in '# by hand' (a comment? label files hold objects alone)"),
        (LINE.replace("1.62", "1_0"), "000001.txt:2: field 'rotation_y': '1_0' is not a number"),
        (LINE.replace("13.22", "1.2.3"), "000001.txt:2: field 'z': '1.2.3' is not a number"),
        (LINE.replace("1.57", "-"), "000001.txt:2: field 'height': '-' is not a number"),
        (LINE.replace("1.57", "."), "000001.txt:2: field 'height': '.' is not a number"),
        (LINE.replace("1.62", "nan"), "000001.txt:2: field 'rotation_y': 'nan' is not finite"),
        (LINE.replace("1.62", "1e999"), "000001.txt:2: field 'rotation_y': '1e999' is not finite"),
        (LINE.replace("614.24", "6é"), "000001.txt:2: field 'x1'"),
    ],
)
def test_a_malformed_line_names_file_line_and_field(
    tmp_path: Path, line: str, message: str
) -> None:
    ids = write(tmp_path, LINE, f"{LINE}\n{line}\n")
    with pytest.raises(DataError, match=re.escape(message)):
        read_table(tmp_path, ids, scored=False)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"000007\.txt: no such file"):
        read_table(tmp_path, ["000007"], scored=False)
