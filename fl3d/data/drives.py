"""Which drive each KITTI frame was recorded on, by the devkit's mapping: frames of one drive are much alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fl3d.core.errors import DataError
from fl3d.data.text import read_lines

FILES = ("train_rand.txt", "train_mapping.txt")


def has_mapping(folder: Path) -> bool:
    """Whether a folder holds the devkit's two files."""
    return all((folder / name).is_file() for name in FILES)


def read_drives(folder: Path, ids: Sequence[str]) -> list[str]:
    """The drive of each of some frames, such as ``2011_09_26_drive_0005_sync``.

    Frame i is line ``train_rand[i]`` (from 1) of ``train_mapping.txt``: date, drive, and frame of the drive.

    Args:
        folder: ``mapping`` of KITTI's object development kit.
        ids: frames of the training set, six digits.

    Raises:
        DataError: a file is missing or malformed, or does not know a frame.
    """
    order, lines = (folder / name for name in FILES)
    places = _numbers(order)
    drives = [line.split() for line in read_lines(lines)]
    found = []
    for frame in ids:
        is_known = frame.isdecimal() and int(frame) < len(places)
        place = places[int(frame)] if is_known else 0
        if not 1 <= place <= len(drives):
            raise DataError(f"no drive of frame {frame}: these are {len(places)} frames", order)
        words = drives[place - 1]
        if len(words) != 3:
            raise DataError(f"'{' '.join(words)}' is not a date, a drive and a frame", lines, place)
        found.append(words[1])
    return found


def _numbers(path: Path) -> list[int]:
    if not path.is_file():
        raise DataError("no such file; it belongs to KITTI's object development kit", path)
    words = " ".join(read_lines(path)).replace(",", " ").split()
    wrong = [word for word in words if not word.isdigit()]
    if wrong:
        raise DataError(f"'{wrong[0]}' is not a line number", path)
    return [int(word) for word in words]
