"""KITTI label and result files: one object a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.text import finite, read_lines

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


@dataclass(frozen=True)
class Labels:
    """The objects of one label or result file, in file order.

    Args:
        types: (N,) names such as ``Car``.
        truncated: (N,) 0 to 1.
        occluded: (N,) 0 visible, 1 partly, 2 largely, 3 unknown.
        alpha: (N,) observation angle in radians; -10 where there is none.
        boxes_image: (N, 4).
        boxes_cam: (N, 7).
        scores: (N,) for result files, else None.
    """

    types: NDArray[np.str_]
    truncated: NDArray[np.float64]
    occluded: NDArray[np.int64]
    alpha: NDArray[np.float64]
    boxes_image: NDArray[np.float64]
    boxes_cam: NDArray[np.float64]
    scores: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.types)

    def select(self, mask: NDArray[np.bool_]) -> Labels:
        """Keep the objects where ``mask`` (N,) is true."""
        return Labels(
            self.types[mask],
            self.truncated[mask],
            self.occluded[mask],
            self.alpha[mask],
            self.boxes_image[mask],
            self.boxes_cam[mask],
            None if self.scores is None else self.scores[mask],
        )


def joined(parts: Sequence[Labels]) -> Labels:
    """Labels without scores, one behind the other."""
    fields = ("types", "truncated", "occluded", "alpha", "boxes_image", "boxes_cam")
    return Labels(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


def labels_from_columns(types: list[str], values: NDArray[np.float64], scored: bool) -> Labels:
    """Arrange numeric columns (N, 14) or, scored, (N, 15) in file order as ``Labels``."""
    return Labels(
        types=np.array(types, dtype=np.str_),
        truncated=values[:, 0],
        occluded=values[:, 1].astype(np.int64),
        alpha=values[:, 2],
        boxes_image=values[:, 3:7],
        boxes_cam=values[:, [10, 11, 12, 7, 8, 9, 13]],
        scores=values[:, 14] if scored else None,
    )


def read_labels(path: Path, scored: bool = False) -> Labels:
    """Read a KITTI label file (15 fields a line) or, ``scored``, a result file (16 fields).

    Raises:
        DataError: names the file, line and field of anything that is missing, is not a finite number, or, in a
            label, is no value that KITTI has.
    """
    types: list[str] = []
    lines: list[int] = []
    rows: list[list[float]] = []
    wanted = 16 if scored else 15
    for number, line in enumerate(read_lines(path), start=1):
        fields = line.split()
        if not fields:
            continue
        if len(fields) < wanted:
            raise DataError(f"{wanted} fields expected, found {len(fields)}", path, number)
        types.append(fields[0])
        rows.append(
            [finite(f, FIELDS[i], path, number) for i, f in enumerate(fields[1:wanted], start=1)]
        )
        lines.append(number)
    values = np.array(rows, dtype=np.float64).reshape(len(rows), wanted - 1)
    labels = labels_from_columns(types, values, scored)
    if not scored:
        _check(labels, lines, path)
    return labels


def _check(labels: Labels, lines: list[int], path: Path) -> None:
    """Refuse label values that KITTI does not have; a region to be ignored (DontCare) has no values."""
    real = np.char.lower(labels.types) != "dontcare" if len(labels) else np.zeros(0, dtype=bool)
    rules = (
        ("truncated", "lie in 0 to 1", (labels.truncated < 0) | (labels.truncated > 1)),
        ("occluded", "be 0, 1, 2 or 3", (labels.occluded < 0) | (labels.occluded > 3)),
        ("height, width, length", "be above 0", (labels.boxes_cam[:, 3:6] <= 0).any(axis=1)),
    )
    for field, must, wrong in rules:
        if (wrong & real).any():
            raise DataError(
                f"field '{field}' must {must}", path, lines[int(np.argmax(wrong & real))]
            )


def write_labels(path: Path, labels: Labels) -> None:
    """Write a label file, or a result file where there are scores: two decimals as KITTI, scores in full."""
    lines = []
    for i in range(len(labels)):
        x, y, z, h, w, length, ry = labels.boxes_cam[i]
        numbers = [*labels.boxes_image[i], h, w, length, x, y, z, ry]
        line = f"{labels.types[i]} {labels.truncated[i]:.2f} {labels.occluded[i]:d} {labels.alpha[i]:.2f} "
        line += " ".join(f"{v:.2f}" for v in numbers)
        if labels.scores is not None:
            line += f" {labels.scores[i]:.9g}"
        lines.append(line + "\n")
    path.write_text("".join(lines))
