"""Read clouds: KITTI's ``.bin``, NumPy's ``.npy`` and PCL's ``.pcd``, known by their first bytes, not their names."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.cloud_forms import CloudFormat, Float, read_bare, survey
from fl3d.data.pcd import REFLECTANCES, is_pcd, read_pcd
from fl3d.data.text import is_there, read_bytes

ENDINGS = ("bin", "npy", "pcd")
MOST_COLUMNS = 16  # of a point; an array that has fewer rows, and more columns, is transposed


@dataclass(frozen=True)
class Cloud:
    """A cloud as it was read.

    Args:
        points_velo: (N, 4) float32: x, y, z in metres, reflectance.
        dropped: points that were left out, for a value of theirs is not finite.
    """

    points_velo: NDArray[np.float32]
    dropped: int = 0


def find_cloud(folder: Path, name: str) -> Path:
    """The file of a frame's cloud: the first of ``.bin``, ``.npy`` and ``.pcd`` that is there, or else ``.bin``."""
    paths = [folder / f"{name}.{ending}" for ending in ENDINGS]
    return next((path for path in paths if is_there(path)), paths[0])


def read_cloud(path: Path, form: CloudFormat | None = None) -> Cloud:
    """Read a cloud; an empty file has no points.

    Args:
        path: of the file, whatever it is called.
        form: how it is to be read; None: as KITTI's.

    Raises:
        DataMissing: it is not there.
        DataError: it cannot be read, is cut off, or looks like what it is not read as.
    """
    form = form or CloudFormat()
    raw = read_bytes(path)
    rows: Float
    if raw.startswith(b"\x93NUMPY"):
        rows = _read_npy(raw, path)
    elif is_pcd(raw):
        rows = read_pcd(raw, path)
    else:
        rows = read_bare(raw, form, path)
    return _cloud(rows, form.reflectance_scale)


def _cloud(rows: Float, scale: float) -> Cloud:
    """(N, >=3) as a cloud of four columns, without what is not finite."""
    points: NDArray[np.float32]
    if rows.shape[1] == 4 and rows.dtype == np.float32:
        points = np.ascontiguousarray(rows)
    else:
        points = np.zeros((len(rows), 4), dtype=np.float32)
        kept = min(rows.shape[1], 4)
        with np.errstate(over="ignore", invalid="ignore"):
            points[:, :kept] = rows[:, :kept]
    bad = survey(points)[0]
    if bad:
        points = points[np.isfinite(points).all(axis=1)]
    if scale != 1:
        points = np.column_stack([points[:, :3], points[:, 3] / np.float32(scale)])
    return Cloud(points, bad)


def _named(rows: NDArray[Any], path: Path) -> Float:
    """Points whose columns have names, as PCD's have."""
    names = {name.lower(): name for name in rows.dtype.names or ()}
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise DataError(
            f"is a NumPy array without a column {', '.join(missing)} (found: {', '.join(names)})",
            path,
        )
    wanted = [*"xyz", *[name for name in REFLECTANCES if name in names][:1]]
    try:
        return np.column_stack([rows[names[n]].ravel().astype(np.float64) for n in wanted])
    except (TypeError, ValueError) as error:
        raise DataError(f"is a NumPy array whose columns are no numbers ({error})", path) from None


def _read_npy(raw: bytes, path: Path) -> Float:
    rows: NDArray[Any]
    try:
        rows = np.load(io.BytesIO(raw), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise DataError(f"is a NumPy file that cannot be read ({error})", path) from None
    if rows.dtype.names is not None:
        return _named(rows, path)
    if rows.ndim == 2 and rows.shape[0] <= MOST_COLUMNS < rows.shape[1]:
        raise DataError(
            f"is a NumPy array of shape {rows.shape}, but points need (N, 3) or more columns: transposed?",
            path,
        )
    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise DataError(
            f"is a NumPy array of {rows.dtype} and shape {rows.shape}, but points need (N, 3) or more columns of "
            "numbers",
            path,
        )
    return rows if rows.dtype.kind == "f" else rows.astype(np.float64)
