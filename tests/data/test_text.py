"""Files that the system does not let be read are named in one line, whatever the reason."""

import errno
import os
from pathlib import Path

import pytest

from fl3d.core.errors import DataError, DataMissing
from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import read_table
from fl3d.data.text import finite, is_there, read_bytes, read_lines


def test_lines_end_in_any_way_and_the_last_end_begins_none(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for content, lines in (
        (b"", []),
        (b"\xef\xbb\xbf", []),
        (b"a\n", ["a"]),
        (b"a\r\nb\rc\n\nd", ["a", "b", "c", "", "d"]),
        ("ü\x85\u2028x\n".encode(), ["ü\x85\u2028x"]),  # which are no ends of lines
    ):
        path.write_bytes(content)
        assert read_lines(path) == lines


def test_what_may_not_be_read_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "read_bytes", refuse)
    monkeypatch.setattr(Path, "exists", refuse)
    monkeypatch.setattr(os, "open", refuse)
    message = r"a\.txt: cannot be read \(Permission denied\)"
    for read in (read_bytes, read_lines, is_there):
        with pytest.raises(DataError, match=message):
            read(tmp_path / "a.txt")
    with pytest.raises(DataError, match=message):
        read_table(tmp_path, ["a"], scored=False)
    folder = KittiFolder(tmp_path, crop="none", calibration="mean")
    for of in (folder.read_labels, folder.read_cloud, folder.image_size):
        with pytest.raises(DataError, match=r"(a\.\w+|image_2): cannot be read \(Permission"):
            of("a")
    with pytest.raises(DataError, match=message):
        folder.split("a")


def test_what_is_missing_is_told_from_what_is_broken(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "a.txt", tmp_path / "file" / "a.txt"):
        with pytest.raises(DataMissing, match=r"a\.txt: no such file"):
            read_bytes(path)


def test_a_missing_file_tells_what_lies_there_instead(tmp_path: Path) -> None:
    folder = tmp_path / "velodyne"
    with pytest.raises(DataMissing, match=r"no such file: there is no folder velodyne"):
        read_bytes(folder / "000007.bin")
    folder.mkdir()
    (folder / "000007.ply").touch()
    (folder / "7.bin").symlink_to("away.bin")
    with pytest.raises(DataMissing, match=r"000007\.bin: no such file \(but 000007\.ply, 7\.bin\)"):
        read_bytes(folder / "000007.bin")
    with pytest.raises(DataMissing, match=r"7\.bin: no such file: a link to away\.bin, which is"):
        read_bytes(folder / "7.bin")


def test_numbers_are_finite_and_plain(tmp_path: Path) -> None:
    assert finite("-1e3", "x", tmp_path, 1) == -1000
    for text, message in (("1_0", "'1_0' is not a number"), ("-inf", "'-inf' is not finite")):
        with pytest.raises(DataError, match=f":1: field 'x': {message}"):
            finite(text, "x", tmp_path, 1)
