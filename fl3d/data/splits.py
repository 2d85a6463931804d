"""Lists of frames: a name a line, such as ``ImageSets/train.txt``."""

from __future__ import annotations

import re
from pathlib import Path

from fl3d.core.errors import DataError
from fl3d.data.text import read_lines

_SEPARATORS = re.compile(r"[\s,;\[\]\"']+")  # between frames on one line, in whatever form
_ENDING = re.compile(r"\.(bin|npy|pcd|txt|png|jpe?g)$", re.IGNORECASE)


def read_split(path: Path) -> list[str]:
    """Frames of a list, in file order: a name a line, of any digits or letters; empty lines do not count.

    Raises:
        DataMissing: there is no such file.
        DataError: a line is no frame's name, or a frame is there twice.
    """
    lines: dict[str, int] = {}
    for number, line in enumerate(read_lines(path), start=1):
        text = line.strip()
        if not text:
            continue
        _check(text, path, number)
        if text in lines:
            raise DataError(f"frame {text} stands in line {lines[text]} already", path, number)
        lines[text] = number
    return list(lines)


def _check(text: str, path: Path, line: int) -> None:
    """Refuse what is no name of a frame.

    Raises:
        DataError: says what to write instead.
    """
    last = re.split(r"[/\\]", text)[-1]
    bare = _ENDING.sub("", last)
    if not bare.strip(". "):
        raise DataError(f"'{text}' is no frame's name, such as 000001", path, line)
    if text.startswith(("#", "//", "%")):
        raise DataError(
            f"'{text}' looks like a comment, which a list of frames cannot hold", path, line
        )
    if len(_SEPARATORS.split(bare)) > 1 or not bare.isprintable():
        first = next((word for word in _SEPARATORS.split(bare) if word), "000001")
        raise DataError(
            f"'{text}' is not one frame's name: write a name a line, such as {first}", path, line
        )
    if bare != text:
        what = "has a path in it" if last != text else "has a file's ending"
        raise DataError(f"'{text}' {what}: write the frame's name alone, {bare}", path, line)
