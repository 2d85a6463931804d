"""What a 2D detector found in the pictures: ``rgb_detections/rgb_detection_{train,val}.txt`` beside KITTI's folders.

The format of Qi et al., Frustum PointNets, CVPR 2018: a box a line, with the picture's path (whose name is the frame),
class (1 Pedestrian, 2 Car, 3 Cyclist, or the name), score, and x1 y1 x2 y2 in pixels; boxes may reach beyond the
picture. Paths may be those of Windows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.label_parser import TYPES, kitti_spelling
from fl3d.data.text import finite, is_there, read_lines

CLASSES = {"Pedestrian": 1, "Car": 2, "Cyclist": 3}
_NUMBERS = {str(number): name for name, number in CLASSES.items()}
_ENDING = re.compile(r"\.(png|jpe?g)$", re.IGNORECASE)
FIELDS = ("score", "x1", "y1", "x2", "y2")
FILES = ("rgb_detection_train.txt", "rgb_detection_val.txt")
FOLDER = "rgb_detections"

ImageBoxes = dict[str, NDArray[np.float64]]


class FoundInPictures:
    """What a 2D detector found of some classes, by frame.

    Args:
        by_class: see ``read_image_boxes``; None: no detector was run.
    """

    def __init__(self, by_class: Mapping[str, ImageBoxes | None]) -> None:
        self._by_class = {name: of for name, of in by_class.items() if of is not None}
        self.is_there = bool(self._by_class)

    @cached_property
    def boxes(self) -> ImageBoxes:
        """(N, 5) of each frame that has any, those of the first class first."""
        frames = dict.fromkeys(frame for of in self._by_class.values() for frame in of)
        return {
            frame: np.concatenate([of[frame] for of in self._by_class.values() if frame in of])
            for frame in frames
        }

    def of(self, frame: str) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
        """Boxes (N, 5) and classes (N,) of a frame."""
        counts = [len(of.get(frame, ())) for of in self._by_class.values()]
        names = np.array(list(self._by_class), dtype=np.str_)
        return self.boxes.get(frame, np.zeros((0, 5))), np.repeat(names, counts)


def read_found(root: Path, classes: Sequence[str]) -> FoundInPictures:
    """What a 2D detector found of some classes, see ``read_image_boxes``."""
    return FoundInPictures({name: read_image_boxes(root, name, classes) for name in classes})


def read_image_boxes(root: Path, name: str, classes: Sequence[str] = ()) -> ImageBoxes | None:
    """Boxes of one class by frame: (N, 5) x1, y1, x2, y2 in pixels and score, in file order.

    None without files; a file that is empty, or names no frame, has no boxes.

    Args:
        root: holds the folder ``rgb_detections``.
        name: of the class.
        classes: that lines may name besides KITTI's.

    Raises:
        DataError: a line is not such a box.
    """
    paths = [root / FOLDER / file for file in FILES if is_there(root / FOLDER / file)]
    if not paths:
        return None
    rows: dict[str, list[list[float]]] = {}
    for path in paths:
        for number, line in enumerate(read_lines(path), start=1):
            fields = line.rsplit(maxsplit=6)
            if not fields:
                continue
            kind = _class(fields[1], classes) if len(fields) == 7 else None
            if kind is None:
                raise DataError(
                    "a box needs a path, a class (1, 2, 3 or KITTI's name), a score and four pixels",
                    path,
                    number,
                )
            if kind == name:
                score, *box = (
                    finite(text, field, path, number)
                    for text, field in zip(fields[2:], FIELDS, strict=True)
                )
                if not 0 <= score <= 1 or box[0] > box[2] or box[1] > box[3]:
                    raise DataError(
                        "a box needs a score in 0..1, and x1 y1 before x2 y2", path, number
                    )
                rows.setdefault(_frame(fields[0]), []).append([*box, score])
    return {frame: np.array(boxes) for frame, boxes in rows.items()}


def _class(text: str, classes: Sequence[str]) -> str | None:
    """A class by its number or its name, KITTI's or one of some; None where it is neither."""
    name = _NUMBERS.get(text) or kitti_spelling(text)
    return name if name in TYPES or name in classes else None


def _frame(path: str) -> str:
    """The frame that a picture's path names."""
    return _ENDING.sub("", re.split(r"[/\\]", path.strip())[-1])
