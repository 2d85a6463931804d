"""Read clouds of the Point Cloud Library's format PCD 0.7: ascii, binary, and binary compressed by LZF.

Its header's lines are told in PCL's tutorial "The PCD (Point Cloud Data) file format".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError

_HEAD = re.compile(rb"(\s*#[^\n]*\n)*\s*(VERSION[ \t]+[.\d]+\s*\n|FIELDS[ \t])", re.IGNORECASE)
_LONGEST = 4096  # bytes of a header
_KINDS = {"F": "f", "I": "i", "U": "u"}
REFLECTANCES = ("intensity", "reflectance", "reflectivity", "i")

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class _Header:
    fields: tuple[str, ...]
    formats: tuple[tuple[str, int], ...]  # NumPy's type and how many
    points: int
    data: str
    size: int


def is_pcd(raw: bytes) -> bool:
    """Whether a file begins as a PCD file does."""
    return _HEAD.match(raw[:_LONGEST]) is not None


def read_pcd(raw: bytes, path: Path) -> NDArray[np.float64]:
    """Points of a PCD file: (N, 4) x, y, z, reflectance, which is 0 where no field is called so.

    Raises:
        DataError: the header or the data cannot be read, or there is no x, y or z.
    """
    header = _read_header(raw, path)
    missing = [name for name in "xyz" if name not in header.fields]
    if missing:
        raise DataError(
            f"PCD: no field {', '.join(missing)} (found: {', '.join(header.fields)})", path
        )
    body = raw[header.size :]
    try:
        if header.data == "ascii":
            columns = _ascii(body, header)
        elif header.data == "binary":
            columns = _binary(body, header)
        else:
            columns = _compressed(body, header)
    except ValueError as error:
        raise DataError(f"PCD: its {header.points} points cannot be read ({error})", path) from None
    reflectance = next((name for name in REFLECTANCES if name in columns), None)
    rows = np.zeros((header.points, 4))
    for place, name in enumerate(("x", "y", "z", reflectance)):
        if name is not None:
            rows[:, place] = columns[name]
    return rows


def _read_header(raw: bytes, path: Path) -> _Header:
    match = re.search(
        rb"^[ \t]*DATA[ \t]+(\w+)[ \t]*\r?\n?", raw[:_LONGEST], re.MULTILINE | re.IGNORECASE
    )
    if match is None:
        raise DataError("PCD: its header has no line DATA", path)
    lines = raw[: match.start()].decode("latin-1").splitlines()
    words = {line.split()[0].upper(): line.split()[1:] for line in lines if line.split()}
    data = match[1].decode().lower()
    if data not in ("ascii", "binary", "binary_compressed"):
        raise DataError(f"PCD: DATA is {data}, not ascii, binary or binary_compressed", path)
    fields = tuple(name.lower() for name in words.get("FIELDS", words.get("COLUMNS", [])))
    try:
        sizes = [int(size) for size in words["SIZE"]]
        kinds = [_KINDS[kind.upper()] for kind in words["TYPE"]]
        counts = [int(count) for count in words.get("COUNT", ["1"] * len(fields))]
        size = int(words["WIDTH"][0]) * int(words.get("HEIGHT", ["1"])[0])
        points = int(words.get("POINTS", [str(size)])[0])
        formats = tuple(
            (np.dtype(f"<{kind}{size}").str, count)
            for kind, size, count in zip(kinds, sizes, counts, strict=True)
        )
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise DataError(f"PCD: its header cannot be read ({error})", path) from None
    if len(formats) != len(fields) or points < 0 or min((c for _, c in formats), default=0) < 1:
        raise DataError("PCD: FIELDS, SIZE, TYPE, COUNT and POINTS do not fit together", path)
    return _Header(fields, formats, points, data, match.end())


def _ascii(body: bytes, header: _Header) -> dict[str, NDArray[np.float64]]:
    width = sum(count for _, count in header.formats)
    values = np.array(body.split(), dtype=np.float64)
    if len(values) != width * header.points:
        raise ValueError(f"{width} numbers each, found {len(values)}")
    rows = values.reshape(header.points, width)
    starts = np.cumsum([0, *(count for _, count in header.formats)])
    return {name: rows[:, start] for name, start in zip(header.fields, starts, strict=False)}


def _binary(body: bytes, header: _Header) -> dict[str, NDArray[np.float64]]:
    """Point after point."""
    kinds = [(f"f{i}", kind, (count,)) for i, (kind, count) in enumerate(header.formats)]
    kind = np.dtype(kinds)
    _enough(body, kind.itemsize * header.points)
    rows = np.frombuffer(body, kind, header.points)
    return {name: rows[f"f{i}"][:, 0].astype(np.float64) for i, name in enumerate(header.fields)}


def _compressed(body: bytes, header: _Header) -> dict[str, NDArray[np.float64]]:
    """Field after field, behind two sizes: compressed, and not."""
    _enough(body, 8)
    packed, size = np.frombuffer(body, "<u4", 2).tolist()
    _enough(body, 8 + packed)
    wanted = header.points * sum(np.dtype(kind).itemsize * count for kind, count in header.formats)
    if size != wanted:
        raise ValueError(f"{wanted} bytes, found {size}")
    plain = np.zeros(size, dtype=np.uint8)
    if unpack_lzf(np.frombuffer(body, np.uint8, packed, 8), plain) != size:
        raise ValueError("its compressed bytes are broken")
    columns, start = {}, 0
    for name, (kind, count) in zip(header.fields, header.formats, strict=True):
        end = start + np.dtype(kind).itemsize * count * header.points
        column = plain[start:end].view(kind).reshape(header.points, count)
        columns[name], start = column[:, 0].astype(np.float64), end
    return columns


def _enough(body: bytes, size: int) -> None:
    if len(body) < size:
        raise ValueError(f"{size} bytes, found {len(body)}; cut off?")


@numba.njit(cache=True)
def unpack_lzf(packed: Bytes, plain: Bytes) -> int:
    """Decompress Marc Lehmann's LZF.

    A byte c below 32 is followed by c + 1 bytes as they are. Else something written before is copied: the upper three
    bits tell its length less 2, where 7 is added to by the next byte; the lower five, and a further byte, how far back
    it begins, less 1.

    Args:
        packed: to decompress.
        plain: to fill.

    Returns:
        how many bytes were written, -1 where the input is broken.
    """
    i = o = 0
    while i < len(packed):
        control = int(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(packed) or o + length > len(plain):
                return -1
            plain[o : o + length] = packed[i : i + length]
            i += length
            o += length
            continue
        length = control >> 5
        if length == 7:
            if i >= len(packed):
                return -1
            length += int(packed[i])
            i += 1
        if i >= len(packed):
            return -1
        start = o - ((control & 31) << 8) - int(packed[i]) - 1
        i += 1
        length += 2
        if start < 0 or o + length > len(plain):
            return -1
        for k in range(length):
            plain[o + k] = plain[start + k]
        o += length
    return o
