"""Labels of many frames as columns, read from KITTI text files in one pass: what the evaluator works on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.data.label_parser import NAMES, OTHER, Codes, parse_files
from fl3d.data.labels import Labels

__all__ = ["NAMES", "OTHER", "LabelTable", "read_table", "table_from_labels"]


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

    @cached_property
    def digest(self) -> str:
        """Identity of all objects and of the frames that they are in; empty where there is no object."""
        if not len(self.types):
            return ""
        found = hashlib.sha256(repr(self.others).encode())
        for column in (self.offsets, self.types, self.values):
            found.update(np.ascontiguousarray(column).tobytes())
        return found.hexdigest()

    def of(self, name: str) -> NDArray[np.bool_]:
        """Which objects are of a class: (N,); KITTI's in whatever case, others as they are spelled."""
        if name.lower() in NAMES:
            code = NAMES.index(name.lower())
        else:
            code = OTHER + self.others.index(name) if name in self.others else -1
        return np.asarray(self.types == code)

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
        scored: whether a line has a score, the 16th field.

    Raises:
        DataError: a file is missing, or a line is malformed; names file, line and field.
    """
    found = parse_files([f"{folder}/{frame_id}.txt" for frame_id in ids], scored)
    return LabelTable(found.offsets, found.types, found.values, found.others)
