"""KITTI label and result files: one object a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.label_parser import TYPES, kitti_spelling, parse_files
from fl3d.data.text import read_lines

__all__ = [
    "TYPES",
    "Labels",
    "check_sizes",
    "joined",
    "labels_from_columns",
    "read_labels",
    "write_labels",
]


@dataclass(frozen=True)
class Labels:
    """The objects of one label or result file, in file order.

    Args:
        types: (N,) names such as ``Car``, KITTI's own as it spells them.
        truncated: (N,) 0 to 1; what others write is kept.
        occluded: (N,) 0 visible, 1 partly, 2 largely, 3 unknown; what others write is kept.
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
    """Read a KITTI label file (15 fields a line or more) or, ``scored``, a result file (16 or more).

    Raises:
        DataError: names the file, line and field of anything that is missing or is not a finite number.
    """
    found = parse_files([path], scored)
    spelled = (*TYPES, *found.others)
    types = [spelled[code] for code in found.types.tolist()]
    return labels_from_columns(types, found.values[:, : 15 if scored else 14], scored)


def check_sizes(labels: Labels, types: Sequence[str], path: Path | None) -> None:
    """Refuse objects without a size among those of some types; others may be without one.

    Args:
        labels: all of a file, in file order.
        types: that are trained on.
        path: the file; None: they come from no file.

    Raises:
        DataError: a height, width or length is not above 0; names its line.
    """
    wrong = (labels.boxes_cam[:, 3:6] <= 0).any(axis=1) & np.isin(labels.types, types)
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    what = f"field 'height, width, length' of a {labels.types[row]} must be above 0"
    if path is None:
        raise DataError(what, "labels")
    lines = [n for n, line in enumerate(read_lines(path), start=1) if line.strip()]
    raise DataError(what, path, lines[row])


def write_labels(path: Path, labels: Labels) -> None:
    """Write a label file, or a result file where there are scores: two decimals as KITTI, scores in full.

    KITTI's own values alone are written: truncated 0 to 1, occluded 0 to 3, and its spelling of its classes.
    """
    lines = []
    for i in range(len(labels)):
        x, y, z, h, w, length, ry = labels.boxes_cam[i]
        numbers = [*labels.boxes_image[i], h, w, length, x, y, z, ry]
        name, truncated, occluded = _strict(labels, i)
        line = f"{name} {truncated:.2f} {occluded:d} {labels.alpha[i]:.2f} "
        line += " ".join(f"{v:.2f}" for v in numbers)
        if labels.scores is not None:
            line += f" {labels.scores[i]:.9g}"
        lines.append(line + "\n")
    path.write_text("".join(lines), encoding="utf-8")


def _strict(labels: Labels, row: int) -> tuple[str, float, int]:
    """Type, truncation and occlusion as KITTI has them; -1 where it has none, of DontCare."""
    name = kitti_spelling(str(labels.types[row]))
    if name == "DontCare":
        return name, labels.truncated[row], labels.occluded[row]
    return name, np.clip(labels.truncated[row], 0, 1), np.clip(labels.occluded[row], 0, 3)
