"""Files of calibrations: KITTI's own for objects, tracking and raw drives, and what converters make of them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.calibration import Calibration
from fl3d.data.text import finite, read_lines

# Names of a matrix, in lower case: KITTI's for objects, for tracking, and for raw drives.
_NAMES = {
    "P2": ("p2", "p_rect_02"),
    "R0_rect": ("r0_rect", "r_rect", "r_rect_00"),
    "Tr_velo_to_cam": ("tr_velo_to_cam", "tr_velo_cam"),
    "R": ("r",),  # of raw drives' calib_velo_to_cam.txt: these two are Tr_velo_to_cam
    "T": ("t",),
}
_MATRIX = {name: matrix for matrix, names in _NAMES.items() for name in names}
# How many values a matrix may have, with its rows and columns.
_SHAPES = {
    "P2": {12: (3, 4), 16: (4, 4), 9: (3, 3)},
    "R0_rect": {9: (3, 3), 12: (3, 4), 16: (4, 4)},
    "Tr_velo_to_cam": {12: (3, 4), 16: (4, 4)},
    "R": {9: (3, 3)},
    "T": {3: (3, 1)},
}
_KEPT = {"P2": (3, 4), "R0_rect": (3, 3), "Tr_velo_to_cam": (3, 4), "R": (3, 3), "T": (3, 1)}
_LINE = re.compile(r"\s*([A-Za-z]\w*)(?:\s*:|\s)(.*)")
# How far M M' may be from 1. Of KITTI's 7481 calibrations it is 9e-8 at most; two digits behind the point give 0.02.
_TOLERANCE = 0.05
_UNIT = np.eye(3)

Matrix = NDArray[np.float64]


def read_calibration(path: Path) -> Calibration:
    """Read one calibration file.

    P2, R0_rect and Tr_velo_to_cam, in any case, or as KITTI's tracking (R_rect, Tr_velo_cam) and raw drives (P_rect_02,
    R_rect_00, R and T) name them, with or without a colon; 3 x 3, 3 x 4 or 4 x 4. Other lines are left out.

    Raises:
        DataError: a matrix is missing, is there twice, has the wrong number of values or one that is no number, or
            cannot be what it is to be: P2 a camera's, the others a rotation.
    """
    found: dict[str, Matrix] = {}
    lines: dict[str, int] = {}
    names: list[str] = []
    for number, line in enumerate(read_lines(path), start=1):
        match = _LINE.match(line)
        if match is None:
            continue
        name, rest = match.groups()
        names.append(name)
        matrix = _MATRIX.get(name.lower())
        if matrix is None:
            continue
        if matrix in found:
            raise DataError(
                f"{name} is given twice: {matrix} stands in line {lines[matrix]} already",
                path,
                number,
            )
        found[matrix] = _matrix(matrix, name, rest.split(), path, number)
        lines[matrix] = number
    if "Tr_velo_to_cam" not in found and {"R", "T"} <= found.keys():
        found["Tr_velo_to_cam"] = np.hstack([found["R"], found["T"]])
    missing = [name for name in ("P2", "R0_rect", "Tr_velo_to_cam") if name not in found]
    if missing:
        raise DataError(_no_line(missing, names), path)
    _check_camera(found["P2"], path)
    for name in ("R0_rect", "Tr_velo_to_cam"):
        _check_rotation(name, found[name][:, :3], path)
    return Calibration(found["P2"], found["R0_rect"], found["Tr_velo_to_cam"])


def _matrix(matrix: str, name: str, values: Sequence[str], path: Path, line: int) -> Matrix:
    """Values as the matrix that is kept; what is left out of it must be as in the unit matrix."""
    shapes = _SHAPES[matrix]
    if len(values) not in shapes:
        usual, *others = shapes
        more = f" ({' or '.join(map(str, others))} will do)" if others else ""
        raise DataError(f"{name} needs {usual} values{more}, found {len(values)}", path, line)
    numbers = [finite(value, name, path, line) for value in values]
    given, (rows, columns) = np.array(numbers).reshape(shapes[len(values)]), _KEPT[matrix]
    if given.shape == (rows, columns):
        return given
    whole, unit = np.eye(4), np.eye(4)
    whole[: given.shape[0], : given.shape[1]] = given
    kept = whole[:rows, :columns].copy()
    whole[:rows, :columns] = unit[:rows, :columns]
    if not np.allclose(whole, unit, atol=1e-6):
        raise DataError(
            f"{name}: what is more than {rows} x {columns} must be as in the unit matrix",
            path,
            line,
        )
    return kept


def _no_line(missing: Sequence[str], names: Sequence[str]) -> str:
    """What to say of matrices that are not there."""
    unknown = {name.lower(): name for name in names if name.lower() not in _MATRIX}
    near = [
        unknown[match]
        for name in missing
        for match in difflib.get_close_matches(name.lower(), unknown, n=1)
    ]
    hint = f"; did you mean {', '.join(dict.fromkeys(near))}?" if near else ""
    return f"no line for {', '.join(missing)} (found: {', '.join(names) or 'nothing'}{hint})"


def _check_camera(P2: Matrix, path: Path) -> None:
    """Refuse what projects nothing.

    Raises:
        DataError: a focal length is not above 0.
    """
    if not P2.any():
        raise DataError(
            "P2 is all zero, so it is no camera's. Without a camera: data.calibration=axes and data.crop=none",
            path,
        )
    if P2[0, 0] <= 0 or P2[1, 1] <= 0:
        raise DataError(
            f"P2 is no camera's: its focal lengths are {P2[0, 0]:g} and {P2[1, 1]:g}, not above 0",
            path,
        )


def _check_rotation(name: str, rotation: Matrix, path: Path) -> None:
    """Refuse what is no rotation.

    Raises:
        DataError: says what it is instead.
    """
    off = np.abs(rotation @ rotation.T - _UNIT).max()
    if off <= _TOLERANCE and np.linalg.det(rotation) > 0:
        return
    lengths = np.linalg.norm(rotation, axis=1)
    if not rotation.any():
        what = "is all zero"
    elif off <= _TOLERANCE:
        what = "is mirrored (determinant -1)"
    elif np.abs(lengths**2 - 1).max() > _TOLERANCE:
        what = f"has rows of length {', '.join(f'{length:.3g}' for length in lengths)}, not 1"
    else:
        what = "has rows that are not at right angles"
    raise DataError(f"{name} is no rotation: its 3 x 3 {what}", path)


def write_calibration(
    path: Path, calibration: Calibration, others: Mapping[str, NDArray[np.float64]] | None = None
) -> None:
    """Write a KITTI calibration file.

    Args:
        path: to write.
        calibration: what fl3d uses.
        others: P0, P1, P3 and Tr_imu_to_velo; a camera that is not given repeats the left colour camera.
    """
    rows = {f"P{i}": calibration.P2 for i in range(4)}
    rows |= {"R0_rect": calibration.R0_rect, "Tr_velo_to_cam": calibration.Tr_velo_to_cam}
    rows["Tr_imu_to_velo"] = np.eye(3, 4)
    rows |= others or {}
    lines = [
        f"{name}: {' '.join(f'{v:.12e}' for v in matrix.ravel())}\n"
        for name, matrix in rows.items()
    ]
    path.write_text("".join(lines), encoding="utf-8")
