"""Labels of many frames as columns, read from KITTI text files in one pass: what the evaluator works on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.labels import FIELDS, TYPES, Labels
from fl3d.data.text import finite

NAMES = tuple(name.lower() for name in TYPES)
OTHER = len(NAMES)  # the first type that KITTI lacks; such objects do not exist for the evaluator


@dataclass(frozen=True)
class LabelTable:
    """Objects of F frames, frame after frame, in file order.

    Args:
        offsets: (F + 1,) where each frame's objects begin.
        types: (N,) index into ``NAMES``, or ``OTHER`` + index into ``others``.
        values: (N, 15) the numeric fields in file order: truncated, occluded, alpha, 2D box, h, w, l, x, y, z, ry,
            score (0 where there is none).
        others: names that KITTI lacks, as they are spelled, in order of first appearance.
    """

    offsets: NDArray[np.int64]
    types: NDArray[np.int64]
    values: NDArray[np.float64]
    others: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def frame(self) -> NDArray[np.int64]:
        """(N,) frame of each object."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    @property
    def boxes_image(self) -> NDArray[np.float64]:
        """(N, 4)."""
        return self.values[:, 3:7]

    @property
    def boxes_cam(self) -> NDArray[np.float64]:
        """(N, 7) x, y, z, h, w, l, ry."""
        return self.values[:, [10, 11, 12, 7, 8, 9, 13]]

    @property
    def scores(self) -> NDArray[np.float64]:
        """(N,)."""
        return self.values[:, 14]


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
        code = self._codes.get(name.lower())
        return OTHER + self._others.setdefault(name, len(self._others)) if code is None else code


def table_from_labels(frames: Sequence[Labels]) -> LabelTable:
    """Arrange frames of labels as one table."""
    codes = Codes()
    offsets = np.concatenate([[0], np.cumsum([len(frame) for frame in frames])]).astype(np.int64)
    types = [codes.of(str(name)) for frame in frames for name in frame.types]
    rows = [_columns(frame) for frame in frames]
    values = np.concatenate(rows) if rows else np.zeros((0, 15))
    values = np.ascontiguousarray(values)
    return LabelTable(offsets, np.array(types, dtype=np.int64), values, codes.others)


def _columns(frame: Labels) -> NDArray[np.float64]:
    scores = np.zeros(len(frame)) if frame.scores is None else frame.scores
    box = frame.boxes_cam[:, [3, 4, 5, 0, 1, 2, 6]]
    return np.column_stack(
        [frame.truncated, frame.occluded, frame.alpha, frame.boxes_image, box, scores]
    )


def read_table(folder: Path, ids: Sequence[str], scored: bool) -> LabelTable:
    """Read the label or, ``scored``, the result files of frames.

    Args:
        folder: holds ``<id>.txt``.
        ids: of the frames.
        scored: whether a line has 16 fields instead of 15.

    Raises:
        DataError: a file is missing, or a line is malformed; names file, line and field.
    """
    chunks = [_read(folder, frame_id) for frame_id in ids]
    raw = b"".join(chunks)
    ends = np.cumsum([len(chunk) for chunk in chunks], dtype=np.int64)
    buffer = np.frombuffer(raw, dtype=np.uint8)

    def path(frame: int) -> Path:
        return folder / f"{ids[frame]}.txt"

    n_lines = int((buffer == 10).sum())
    fields = 16 if scored else 15
    short, slow, offsets, names, values = _parse(buffer, ends, n_lines, fields)
    slow = slow[slow[:, 2] < len(values)]  # not those of a line that is cut short
    if not _fill_slow(buffer, slow, values):
        for (
            start,
            end,
            row,
            field,
            frame,
            line,
        ) in slow.tolist():  # most likely one is no number: say which
            values[row, field - 1] = finite(
                raw[start:end].decode("latin-1"), FIELDS[field], path(frame), line
            )
    if short[0] >= 0:
        frame, line, found = short.tolist()
        raise DataError(f"{fields} fields expected, found {found}", path(frame), line)
    codes = Codes()
    types = _codes(raw, names, codes)
    return LabelTable(offsets, types, values, codes.others)


def _read(folder: Path, frame_id: str) -> bytes:
    path = f"{folder}/{frame_id}.txt"
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        raise DataError("no such file", path) from None
    try:
        size = os.fstat(descriptor).st_size
        return os.read(descriptor, size + 1) + b"\n"
    finally:
        os.close(descriptor)


def _codes(raw: bytes, names: NDArray[np.int64], codes: Codes) -> NDArray[np.int64]:
    """Codes from where each name begins and ends."""
    seen: dict[bytes, int] = {}
    found = np.empty(len(names), dtype=np.int64)
    for i, (start, end) in enumerate(names.tolist()):
        name = raw[start:end]
        code = seen.get(name)
        if code is None:
            code = seen[name] = codes.of(name.decode("utf-8", errors="replace"))
        found[i] = code
    return found


def _fill_slow(
    buffer: NDArray[np.uint8], slow: NDArray[np.int64], values: NDArray[np.float64]
) -> bool:
    """Read the fields left by ``_parse`` with NumPy's own reader; False where one is no finite number."""
    if not len(slow):
        return True
    texts = _gather(buffer, slow[:, 0].copy(), slow[:, 1].copy())
    if (texts == ord("_")).any():
        return False
    try:
        numbers = texts.view(f"S{texts.shape[1]}")[:, 0].astype(np.float64)
    except ValueError:
        return False
    values[slow[:, 2], slow[:, 3] - 1] = numbers
    return bool(np.isfinite(numbers).all())


@numba.njit(cache=True)
def _gather(
    buffer: NDArray[np.uint8], starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Texts of equal width, filled up with zeros."""
    texts = np.zeros((len(starts), (ends - starts).max()), dtype=np.uint8)
    for i in range(len(starts)):
        for k in range(ends[i] - starts[i]):
            texts[i, k] = buffer[starts[i] + k]
    return texts


@numba.njit(cache=True)
def _decimal(buffer: NDArray[np.uint8], start: int, end: int) -> tuple[float, bool]:
    """Value of a plain decimal and whether it was read: exact, for up to 15 digits and 22 places are exact."""
    i, sign = start, 1.0
    if buffer[i] == 45 or buffer[i] == 43:
        sign = -1.0 if buffer[i] == 45 else 1.0
        i += 1
    mantissa, digits, seen, places, point = 0, 0, 0, 0, False
    while i < end:
        c = buffer[i]
        if 48 <= c <= 57:
            mantissa = mantissa * 10 + (c - 48)
            seen += 1
            digits += mantissa > 0
            places += point
        elif c == 46 and not point:
            point = True
        else:
            return 0.0, False
        i += 1
        if digits > 15:
            return 0.0, False
    if seen == 0 or places > 22:
        return 0.0, False
    scale = 1.0
    for _ in range(places):
        scale *= 10.0
    return sign * mantissa / scale, True


@numba.njit(cache=True)
def _parse(
    buffer: NDArray[np.uint8], ends: NDArray[np.int64], n_lines: int, fields: int
) -> tuple[
    NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]
]:
    """Split all files into lines and fields.

    Returns:
        the first line with too few fields (frame, line, fields found; -1 where there is none), the fields that are
        left to Python (start, end, row, field, frame, line), frame offsets, where names begin and end, and values.
    """
    offsets = np.zeros(len(ends) + 1, dtype=np.int64)
    names = np.empty((n_lines, 2), dtype=np.int64)
    values = np.zeros((n_lines, 15))
    slow = np.empty((64, 6), dtype=np.int64)
    short = np.full(3, -1, dtype=np.int64)
    row = n_slow = i = 0
    for frame in range(len(ends)):
        line = 0
        while i < ends[frame]:
            line += 1
            field = 0
            while buffer[i] != 10:
                if buffer[i] <= 32:
                    i += 1
                    continue
                start = i
                while buffer[i] > 32:
                    i += 1
                if field == 0:
                    names[row, 0], names[row, 1] = start, i
                elif field < fields:
                    value, is_read = _decimal(buffer, start, i)
                    values[row, field - 1] = value
                    if not is_read:
                        if n_slow == len(slow):
                            slow = np.concatenate((slow, np.empty_like(slow)))
                        slow[n_slow] = np.array([start, i, row, field, frame, line])
                        n_slow += 1
                field += 1
            i += 1
            if 0 < field < fields or field > 16 or (fields == 16 and field > fields):
                short[0], short[1], short[2] = frame, line, field
                return short, slow[:n_slow], offsets, names[:row], values[:row]
            row += field > 0
        offsets[frame + 1] = row
    return short, slow[:n_slow], offsets, names[:row].copy(), values[:row].copy()
