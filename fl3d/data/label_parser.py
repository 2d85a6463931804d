"""The one parser of KITTI's label and result files: for training, evaluation and prediction alike."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.label_kernels import CR, LF, gather, split_fields
from fl3d.data.text import finite, text_bytes, unreadable

FIELDS = (
    *("type", "truncated", "occluded", "alpha", "x1", "y1", "x2", "y2"),
    *("height", "width", "length", "x", "y", "z", "rotation_y", "score"),
)
TYPES = (
    "Car",
    "Van",
    "Truck",
    "Pedestrian",
    "Person_sitting",
    "Cyclist",
    "Tram",
    "Misc",
    "DontCare",
)
NAMES = tuple(name.lower() for name in TYPES)
OTHER = len(NAMES)  # the first type that KITTI lacks; such objects do not exist for the evaluator
_OCCLUDED = FIELDS.index("occluded")
# Blanks of no width or of Unicode, and byte order marks, which editors and web pages leave around a name.
_UNSEEN = "\ufeff\u200b\u200c\u200d\u2060\u00ad\u00a0\u2007\u202f\u3000"
_MOST = 1e9  # of occluded's size, so that it stays a whole number


class Codes:
    """Numbers of the names of classes, given as they appear; KITTI's own without regard to case."""

    def __init__(self) -> None:
        self._codes = {name: code for code, name in enumerate(NAMES)}
        self._others: dict[str, int] = {}

    @property
    def others(self) -> tuple[str, ...]:
        """The names that KITTI lacks, in order of first appearance."""
        return tuple(self._others)

    def of(self, name: str) -> int:
        """Index into ``NAMES``, or ``OTHER`` + index into ``others``."""
        name = name.strip(_UNSEEN) or name
        code = self._codes.get(name.lower())
        return OTHER + self._others.setdefault(name, len(self._others)) if code is None else code


def kitti_spelling(name: str) -> str:
    """A class as KITTI spells it, whatever its case: ``car`` is ``Car``; other names stay as they are."""
    code = Codes().of(name)
    return TYPES[code] if code < OTHER else name


@dataclass(frozen=True)
class Objects:
    """Objects of F files, file after file, in file order.

    Args:
        offsets: (F + 1,) where each file's objects begin.
        types: (N,) see ``Codes.of``.
        values: (N, 15) the numeric fields in file order; the score is 0 where there is none.
        others: names that KITTI lacks, as they are spelled, in order of first appearance.
    """

    offsets: NDArray[np.int64]
    types: NDArray[np.int64]
    values: NDArray[np.float64]
    others: tuple[str, ...]


def parse_files(paths: Sequence[Path | str], scored: bool) -> Objects:
    """Read label files, with 15 fields a line or more, or, ``scored``, result files, with 16 or more.

    Further fields are left out. Occlusion becomes a whole number, toward 0. No value is refused that is a number:
    KITTI's evaluator compares truncation and occlusion with what a difficulty allows, whatever they are.

    Raises:
        DataError: a file is missing or no text, or a line is malformed; names file, line and field.
    """
    chunks = [_read(path) for path in paths]
    raw = b"".join(chunks)
    ends = np.cumsum([len(chunk) for chunk in chunks], dtype=np.int64)
    buffer = np.frombuffer(raw, dtype=np.uint8)
    n_lines = sum(chunk.count(LF) + chunk.count(CR) for chunk in chunks)
    fields = 16 if scored else 15
    short, slow, offsets, names, values = split_fields(buffer, ends, n_lines, fields)
    slow = slow[slow[:, 2] < len(values) - (short[0] >= 0)]  # not those of a line that is cut short
    if len(slow) and not _fill_slow(buffer, slow, values):
        _name_what_is_no_number(raw, slow, names, values, paths)
    if short[0] >= 0:
        frame, line, found = short.tolist()
        start, end = names[-1].tolist()
        hint = _short(raw[start:].splitlines()[0], raw[start:end], fields, found)
        raise DataError(f"{fields} fields expected, found {found}{hint}", Path(paths[frame]), line)
    if not scored:
        occluded = np.clip(values[:, _OCCLUDED - 1], -_MOST, _MOST)
        values[:, _OCCLUDED - 1] = np.trunc(occluded) + 0.0  # no -0
    codes = Codes()
    types = _types(raw, names, codes, ends, paths)
    return Objects(offsets, types, values, codes.others)


def _short(line: bytes, first: bytes, fields: int, found: int) -> str:
    """What a line with too few fields may be, and how it begins."""
    if b"," in first or b";" in first:
        why = "KITTI separates them by blanks"
    elif first.startswith((b"#", b"//")):
        why = "a comment? label files hold objects alone"
    elif (fields, found) == (16, 15):
        why = "a result's last field is its score: is this a label file?"
    else:
        why = f"they are {' '.join(FIELDS[:fields])}"
    text = line.decode("utf-8", errors="replace").strip()
    return f" in '{text[:40]}{'...' * (len(text) > 40)}' ({why})"


def _read(path: Path | str) -> bytes:
    """A file's bytes, its last line ended; twice as fast as ``Path.read_bytes``."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            raw = os.read(descriptor, os.fstat(descriptor).st_size + 1)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise unreadable(Path(path), error) from None
    return text_bytes(raw, path) + b"\n"


def _types(
    raw: bytes,
    names: NDArray[np.int64],
    codes: Codes,
    ends: NDArray[np.int64],
    paths: Sequence[Path | str],
) -> NDArray[np.int64]:
    """Codes from where each name begins and ends."""
    seen: dict[bytes, int] = {}
    found = np.empty(len(names), dtype=np.int64)
    for i, (start, end) in enumerate(names.tolist()):
        name = raw[start:end]
        code = seen.get(name)
        if code is None:
            try:
                code = seen[name] = codes.of(name.decode())
            except UnicodeDecodeError:
                file = Path(paths[int(np.searchsorted(ends, start, side="right"))])
                text = name.decode("utf-8", errors="replace")
                raise DataError(
                    f"is not a text file of UTF-8: class '{text}'. Of Latin-1 or Windows-1252? Save it as UTF-8",
                    file,
                ) from None
        found[i] = code
    return found


def _fill_slow(
    buffer: NDArray[np.uint8], slow: NDArray[np.int64], values: NDArray[np.float64]
) -> bool:
    """Read the fields left by ``split_fields`` with NumPy's own reader; False where one is no finite number."""
    texts = gather(buffer, slow[:, 0].copy(), slow[:, 1].copy())
    if (texts == ord("_")).any():
        return False
    try:
        numbers = texts.view(f"S{texts.shape[1]}")[:, 0].astype(np.float64)
    except ValueError:
        return False
    values[slow[:, 2], slow[:, 3] - 1] = numbers
    return bool(np.isfinite(numbers).all())


def _name_what_is_no_number(
    raw: bytes,
    slow: NDArray[np.int64],
    names: NDArray[np.int64],
    values: NDArray[np.float64],
    paths: Sequence[Path | str],
) -> None:
    """Read the slow fields one by one.

    Raises:
        DataError: names the first that is no finite number.
    """
    for start, end, row, field, frame, line in slow.tolist():
        text = raw[start:end].decode("utf-8", errors="replace")
        path = Path(paths[frame])
        try:
            values[row, field - 1] = finite(text, FIELDS[field], path, line)
        except DataError:
            first, last = names[row].tolist()
            if field == _OCCLUDED and raw[first:last].isdigit():
                raise DataError(
                    f"is a row of KITTI tracking (frame, track, then '{text}' and so on): write a file a frame, "
                    "and leave the first two columns out",
                    path,
                    line,
                ) from None
            raise
