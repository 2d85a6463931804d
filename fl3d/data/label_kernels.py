"""The fast part of reading label files: all of them split into fields, and plain decimals read exactly."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

LF, CR, BLANK = 10, 13, 32

Bytes = NDArray[np.uint8]
Int = NDArray[np.int64]


@numba.njit(cache=True)
def gather(buffer: Bytes, starts: Int, ends: Int) -> Bytes:
    """Texts of equal width, filled up with zeros."""
    texts = np.zeros((len(starts), (ends - starts).max()), dtype=np.uint8)
    for i in range(len(starts)):
        for k in range(ends[i] - starts[i]):
            texts[i, k] = buffer[starts[i] + k]
    return texts


@numba.njit(cache=True)
def _decimal(buffer: Bytes, start: int, end: int) -> tuple[float, bool]:
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
def split_fields(
    buffer: Bytes, ends: Int, n_lines: int, fields: int
) -> tuple[Int, Int, Int, Int, NDArray[np.float64]]:
    """Split files into lines and fields.

    Args:
        buffer: the files, one behind the other; each ends a line.
        ends: where each file ends.
        n_lines: at least as many as there are.
        fields: read of each line; further ones are left out.

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
            while buffer[i] != LF and buffer[i] != CR:
                if buffer[i] <= BLANK:
                    i += 1
                    continue
                start = i
                while buffer[i] > BLANK:
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
            if buffer[i] == CR and i + 1 < ends[frame] and buffer[i + 1] == LF:
                i += 1
            i += 1
            if 0 < field < fields:
                short[0], short[1], short[2] = frame, line, field
                return short, slow[:n_slow], offsets, names[: row + 1], values[: row + 1]
            row += field > 0
        offsets[frame + 1] = row
    return short, slow[:n_slow], offsets, names[:row].copy(), values[:row].copy()
