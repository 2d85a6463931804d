"""Clouds without a header (``.bin``): read as told, or as KITTI's, and refused where they look like another form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, DataError

Float = NDArray[np.floating[Any]]

DTYPES = {"float32": "<f4", "float64": "<f8"}
# Metres that no coordinate reaches, nor one in millimetres or of a map: the Earth is 6.4e6 m thick, and a map's
# coordinates go to 1e7.
FARTHEST = 1e8
# Columns mixed up give negative reflectances: 16 to 63 % of them where KITTI's 32 clouds are written with 3, 5 or 6
# columns and read with 4. A right cloud may hold a few.
MOST_NEGATIVE = 0.005
# Metres nearer to 0 than any measure, and not 0. Whole numbers and other byte orders read as floats give them: 42 % of
# the coordinates or more where KITTI's 32 clouds are written as int16, int32 or big-endian float32; these clouds none.
TINY = 1e-6
MOST_TINY = 0.01
SAMPLE = 4000  # values from which columns are told: half a revolution of one laser
# How much nearer neighbours must be with another number of columns. Written with 3 to 7 columns, KITTI's 32 clouds have
# them 140 times nearer with their own number than with 4; with 4, and in a random order, 2.4 times nearer than with
# any other.
NEARER = 4
OTHER_COLUMNS = (3, 5, 6, 7, 8)
_FOREIGN = {
    b"ply": "a PLY file",
    b"LASF": "a LAS file",
    b"PK\x03\x04": "an archive, such as NumPy's npz",
    b"\x1f\x8b": "compressed by gzip",
    b"\x89HDF": "an HDF5 file",
}


@dataclass(frozen=True)
class CloudFormat:
    """How clouds without a header (``.bin``) are to be read, and what all clouds' reflectance is divided by.

    Args:
        columns: values of a point: x, y, z, reflectance (0 where there are three), and others that are left out; None:
            4, and a file that does not look so is refused.
        dtype: ``float32`` or ``float64``; None: float32, and a file that does not look so is refused.
        reflectance_scale: 1 for reflectances of 0 to 1, 255 for 0 to 255.

    Raises:
        ConfigError: a value that cannot be.
    """

    columns: int | None = None
    dtype: str | None = None
    reflectance_scale: float = 1.0

    def __post_init__(self) -> None:
        columns, scale = self.columns, self.reflectance_scale
        if columns is not None and not (_is_number(columns, int) and columns >= 3):
            raise ConfigError(f"data.cloud.columns: {columns}, but it is null, 3, 4, 5 or more")
        if self.dtype is not None and self.dtype not in DTYPES:
            raise ConfigError(
                f"data.cloud.dtype: no choice '{self.dtype}'. Possible: null, {', '.join(DTYPES)}."
            )
        if not (_is_number(scale, int | float) and 0 < scale < np.inf):
            raise ConfigError(f"data.cloud.reflectance_scale: {scale}, but it is a number above 0")


def read_bare(raw: bytes, form: CloudFormat, path: Path) -> Float:
    """Points of a file without a header, as told or as KITTI's; refused where it does not look so."""
    _refuse_foreign(raw, path)
    columns, dtype = form.columns or 4, form.dtype or "float32"
    step = columns * np.dtype(DTYPES[dtype]).itemsize
    is_told = form.columns is not None and form.dtype is not None
    rows: Float | None = (
        None if len(raw) % step else np.frombuffer(raw, DTYPES[dtype]).reshape(-1, columns)
    )
    wrong = "" if rows is None or is_told else what_looks_wrong(rows)
    if rows is not None and not wrong:
        return rows
    found = None if is_told else _other_form(raw, form)
    if found is not None:
        raise DataError(f"looks like {found[0]}{wrong and f' ({wrong})'}: give {found[1]}", path)
    if rows is None:
        raise DataError(
            f"{len(raw)} bytes are not a whole number of points of {columns} columns of {dtype} ({step} bytes); cut "
            "off? Other forms: data.cloud.columns, data.cloud.dtype",
            path,
        )
    raise DataError(
        f"does not look like points of {columns} columns of {dtype}: {wrong}. Other types, byte orders and orders of "
        f"columns must be converted; {' and '.join(DTYPES)} are read. To read it so all the same: "
        f"data.cloud.columns={columns} data.cloud.dtype={dtype}",
        path,
    )


def _refuse_foreign(raw: bytes, path: Path) -> None:
    """Refuse files of other kinds, known by their first bytes.

    Raises:
        DataError: says what the file is.
    """
    foreign = next((what for first, what in _FOREIGN.items() if raw.startswith(first)), None)
    head = raw[:256]
    if foreign is None and head and all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head):
        foreign = f"text ('{head[:30].decode().split(chr(10))[0].strip()}')"
    if foreign is not None:
        raise DataError(
            f"is {foreign}, not a cloud of KITTI's form: write .bin, .npy or .pcd", path
        )


def _other_form(raw: bytes, form: CloudFormat) -> tuple[str, str] | None:
    """The other form that a file looks like: what to call it, and the keys that say it."""
    for dtype in [form.dtype] if form.dtype else DTYPES:  # pairs of float32 can pass for float64
        columns = _own_columns(raw, dtype, [form.columns] if form.columns else (4, *OTHER_COLUMNS))
        if columns is None:
            continue
        names, keys = [], []
        if dtype != (form.dtype or "float32"):
            names, keys = [dtype], [f"data.cloud.dtype={dtype}"]
        if columns != (form.columns or 4):
            names, keys = [f"{columns} columns", *names], [f"data.cloud.columns={columns}", *keys]
        return " of ".join(names), " ".join(keys)
    return None


def _own_columns(raw: bytes, dtype: str, possible: Sequence[int]) -> int | None:
    """The number of columns with which neighbours are nearest, of those that look right; None where none does."""
    found: dict[int, float] = {}
    for columns in possible:
        if len(raw) % (columns * np.dtype(DTYPES[dtype]).itemsize) == 0:
            rows = np.frombuffer(raw, DTYPES[dtype]).reshape(-1, columns)
            if not what_looks_wrong(rows):
                found[columns] = distance(rows.ravel(), columns)
    # Points further along a scan are near too: of twice the columns, the fewer are meant.
    near = [n for n in sorted(found) if found[n] <= NEARER * min(found.values())]
    return near[0] if near else None


def what_looks_wrong(rows: Float) -> str:
    """What about points (N, 3 or more) no sensor gives; empty where they look right."""
    bad, farthest, negative, tiny = survey(rows)
    if bad == len(rows) > 0:
        return "no point is finite"
    coordinates = 3 * (len(rows) - bad)
    if farthest > FARTHEST:
        return f"|xyz| up to {farthest:.2g} m"
    if tiny > MOST_TINY * coordinates:
        return f"{100 * tiny / coordinates:.0f} % of the coordinates are not 0, but nearer than {TINY:g} m to it"
    if negative > MOST_NEGATIVE * len(rows):
        return f"{100 * negative / len(rows):.0f} % of the reflectances are below 0"
    values, columns = rows.ravel()[:SAMPLE], rows.shape[1]
    others = [distance(values, n) for n in OTHER_COLUMNS if n % columns]
    if NEARER * min(others) < distance(values, columns):
        return "neighbouring points are far apart"
    return ""


def distance(values: Float, columns: int) -> float:
    """How far values differ that stand ``columns`` apart, in the median: least for a scan's own number of columns."""
    values = values[:SAMPLE]
    if len(values) <= 4 * columns:
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.abs(values[columns:] - values[:-columns])
    return float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else np.inf


@numba.njit(cache=True)
def survey(rows: Float) -> tuple[int, float, int, int]:
    """What points hold.

    Returns:
        how many are not finite; of the others the largest |x|, |y| or |z|, how many reflectances are below 0, and how
        many coordinates are nearer to 0 than any measure, and not 0.
    """
    bad, negative, tiny, farthest = 0, 0, 0, 0.0
    has_reflectance = rows.shape[1] > 3
    for i in range(len(rows)):
        x, y, z = abs(rows[i, 0]), abs(rows[i, 1]), abs(rows[i, 2])
        r = rows[i, 3] if has_reflectance else x * 0
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z) and np.isfinite(r)):
            bad += 1
            continue
        farthest = max(farthest, x, y, z)
        negative += r < 0
        tiny += (0 < x < TINY) + (0 < y < TINY) + (0 < z < TINY)
    return bad, farthest, negative, tiny


def _is_number(value: object, kind: object) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)  # type: ignore[arg-type]
