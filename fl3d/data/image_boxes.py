"""What a 2D detector found in the pictures: ``rgb_detections/rgb_detection_{train,val}.txt`` beside KITTI's folders.

The format of Qi et al., Frustum PointNets, CVPR 2018: a box a line, with the picture's path (whose name is the frame),
class (1 Pedestrian, 2 Car, 3 Cyclist), score, and x1 y1 x2 y2 in pixels; boxes may reach beyond the picture.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.text import finite, read_lines

CLASSES = {"Pedestrian": 1, "Car": 2, "Cyclist": 3}
FIELDS = ("score", "x1", "y1", "x2", "y2")
FILES = ("rgb_detection_train.txt", "rgb_detection_val.txt")
FOLDER = "rgb_detections"

ImageBoxes = dict[str, NDArray[np.float64]]


def read_image_boxes(root: Path, name: str = "Car") -> ImageBoxes | None:
    """Boxes of one class by frame: (N, 5) x1, y1, x2, y2 in pixels and score, in file order; None without files.

    Args:
        root: holds the folder ``rgb_detections``.
        name: of the class.

    Raises:
        DataError: a line is not such a box.
    """
    paths = [root / FOLDER / file for file in FILES if (root / FOLDER / file).exists()]
    if not paths:
        return None
    rows: dict[str, list[list[float]]] = {}
    for path in paths:
        for number, line in enumerate(read_lines(path), start=1):
            fields = line.rsplit(maxsplit=6)
            if not fields:
                continue
            if len(fields) != 7 or fields[1] not in ("1", "2", "3"):
                raise DataError(
                    "a box needs a path, a class 1, 2 or 3, a score and four pixels", path, number
                )
            if int(fields[1]) == CLASSES[name]:
                score, *box = (
                    finite(text, field, path, number)
                    for text, field in zip(fields[2:], FIELDS, strict=True)
                )
                if not 0 <= score <= 1 or box[0] > box[2] or box[1] > box[3]:
                    raise DataError(
                        "a box needs a score in 0..1, and x1 y1 before x2 y2", path, number
                    )
                rows.setdefault(Path(fields[0]).stem, []).append([*box, score])
    return {frame: np.array(boxes) for frame, boxes in rows.items()}
