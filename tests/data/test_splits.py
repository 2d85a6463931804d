"""Lists of frames: what is a frame's name, and what is refused with what to write instead."""

import re
from pathlib import Path

import pytest

from fl3d.core.errors import DataError
from fl3d.data.splits import read_split


def split(folder: Path, content: bytes) -> Path:
    path = folder / "train.txt"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "content",
    [
        b"000001\n0000000002\nn015-2018-07\n",
        b"\xef\xbb\xbf000001\n0000000002\nn015-2018-07",
        b"000001\r\n0000000002\r\nn015-2018-07\r\n\r\n",
        b"\n  000001\t\n\n0000000002 \nn015-2018-07\n\n",
        b"000001\r0000000002\rn015-2018-07\r",
    ],
)
def test_names_of_any_digits_and_letters_are_read_in_order(tmp_path: Path, content: bytes) -> None:
    assert read_split(split(tmp_path, content)) == ["000001", "0000000002", "n015-2018-07"]


def test_a_name_with_dots_stays_whole(tmp_path: Path) -> None:
    assert read_split(split(tmp_path, b"segment.1.5\n")) == ["segment.1.5"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("000001", "train.txt:3: frame 000001 stands in line 1 already"),
        ("000002.bin", "'000002.bin' has a file's ending: write the frame's name alone, 000002"),
        ("000002.TXT", "'000002.TXT' has a file's ending: write the frame's name alone, 000002"),
        ("training/velodyne/000002", "has a path in it: write the frame's name alone, 000002"),
        ("training\\image_2\\000002.png", "has a path in it: write the frame's name alone, 000002"),
        ("000002 000003", "is not one frame's name: write a name a line, such as 000002"),
        ("000002 -1", "is not one frame's name: write a name a line, such as 000002"),
        ("# night", "'# night' looks like a comment, which a list of frames cannot hold"),
        ("000002,000003", "is not one frame's name: write a name a line, such as 000002"),
        ('["000002", "000003"]', "is not one frame's name: write a name a line, such as 000002"),
        ("..", "'..' is no frame's name"),
        ("velodyne/", "'velodyne/' is no frame's name"),
        (".bin", "'.bin' is no frame's name"),
    ],
)
def test_a_line_that_is_no_name_says_what_to_write(tmp_path: Path, line: str, message: str) -> None:
    path = split(tmp_path, f"000001\n\n{line}\n".encode())
    with pytest.raises(DataError, match=re.escape(message)) as caught:
        read_split(path)
    assert caught.value.line == 3


def test_what_is_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"train\.txt: is not a text file of UTF-8 but of UTF-16"):
        read_split(split(tmp_path, "000001\n".encode("utf-16")))
    with pytest.raises(DataError, match=r"train\.txt: is not a text file"):
        read_split(split(tmp_path, "000001\n".encode("utf-16-le")))
    with pytest.raises(DataError, match=r": is a folder, but a file is needed"):
        read_split(tmp_path)
    with pytest.raises(DataError, match=r"val\.txt: no such file"):
        read_split(tmp_path / "val.txt")
