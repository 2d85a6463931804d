"""What a 2D detector found in the pictures: ``rgb_detections/rgb_detection_{train,val}.txt`` beside KITTI's folders.

The format of Qi et al., Frustum PointNets, CVPR 2018: a box a line, with the picture's path (whose name is the frame),
class (1 Pedestrian, 2 Car, 3 Cyclist, or the name), score, and x1 y1 x2 y2 in pixels; boxes may reach beyond the
picture. Paths may be those of Windows.
"""

from __future__ import annotations

import re
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


def read_image_boxes(root: Path, name: str = "Car") -> ImageBoxes | None:
    """Boxes of one class by frame: (N, 5) x1, y1, x2, y2 in pixels and score, in file order.

    None without files; a file that is empty, or names no frame, has no boxes.

    Args:
        root: holds the folder ``rgb_detections``.
        name: of the class.

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
            kind = _class(fields[1]) if len(fields) == 7 else None
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


def _class(text: str) -> str | None:
    """A class by its number or its name as KITTI spells it; None where it is neither."""
    name = _NUMBERS.get(text) or kitti_spelling(text)
    return name if name in TYPES else None


def _frame(path: str) -> str:
    """The frame that a picture's path names."""
    return _ENDING.sub("", re.split(r"[/\\]", path.strip())[-1])
