"""Whether a label's box in the picture and its box in space are of the same object, through the calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from fl3d.data.projection import project_boxes
from fl3d.inspection.facts import Beside, Facts
from fl3d.inspection.finding import Finding, warning

Boxes = NDArray[np.float64]

# Overlap (IoU) of the two boxes in the median of a class. Of whole, visible objects of every twentieth KITTI frame it
# is 0.99 for cars and cyclists; people's were drawn by hand: 0.67. Another camera's P2 (P3) gives cars 0.67, boxes that
# stand half their height too high 0.34, sizes in another order 0.34, a LiDAR's yaw as rotation_y 0.59.
LEAST = {"Pedestrian": 0.4, "Person_sitting": 0.4}
LEAST_OF_OTHERS = 0.75
FEW = 5  # objects, of which nothing is told
NEAREST = 3.0  # metres: nearer objects reach beyond the picture

AS_THEY_ARE = (
    "Is P2 that of these pictures, are 2D boxes x1 y1 x2 y2 in pixels, sizes height, width, length, x y z the middle "
    "of the bottom in the camera's frame, and rotation_y radians about its y axis?"
)
Change = Callable[[Boxes, Boxes], tuple[Boxes, Boxes]]
# What would make them fit, of 3D and 2D boxes, and how it is told.
CAUSES: tuple[tuple[str, Change], ...] = (
    (
        "They fit where y is the middle of the 3D boxes: KITTI's y is their bottom, half the height further down.",
        lambda cam, image: (cam + np.outer(cam[:, 3] / 2, [0, 1, 0, 0, 0, 0, 0]), image),
    ),
    (
        "They fit where the 2D boxes are x, y, width, height: KITTI's are x1 y1 x2 y2.",
        lambda cam, image: (cam, np.hstack([image[:, :2], image[:, :2] + image[:, 2:]])),
    ),
)


def of_fit(facts: Facts) -> Iterator[Finding]:
    """Classes whose boxes in the picture and in space do not fit; nothing of labels without one of the two."""
    if facts.kitti.calibration != "frame":
        return
    for name in sorted({name for one in facts.wanted for name in one.classes}):
        least = LEAST.get(name, LEAST_OF_OTHERS)
        overlap, n, first = _overlap(facts, name, lambda cam, image: (cam, image))
        if n < FEW or overlap >= least:
            continue
        causes = (why for why, change in CAUSES if _overlap(facts, name, change)[0] >= least)
        yield warning(
            f"2D boxes and projected 3D boxes of {n} whole, visible labels of class {name} overlap (IoU) by "
            f"{overlap:.2f} in the median, less than {least:g}.",
            next(causes, AS_THEY_ARE),
            facts.kitti.path("label_2", first),
        )


def _overlap(facts: Facts, name: str, change: Change) -> tuple[float, int, str]:
    """Median IoU of a class, of how many objects, and the first frame that has one."""
    found: list[float] = []
    first = ""
    for frame_id, beside in facts.beside.items():
        values = _of_frame(beside, name, change)
        if len(values) and not first:
            first = frame_id
        found.extend(values)
    return (float(np.median(found)) if found else 1.0), len(found), first


def _of_frame(beside: Beside, name: str, change: Change) -> NDArray[np.float64]:
    labels, calibration, size = beside.labels, beside.calibration, beside.image_size
    if labels is None or calibration is None or size is None:
        return np.zeros(0)
    has_both = labels.boxes_image.any(axis=1) & (labels.boxes_image >= 0).all(axis=1)
    has_both &= (labels.boxes_cam[:, 3:6] > 0).all(axis=1) & (labels.boxes_cam[:, 2] > NEAREST)
    seen = (labels.types == name) & (labels.truncated < 0.1) & (labels.occluded <= 0) & has_both
    cam, image = change(labels.boxes_cam[seen], labels.boxes_image[seen])
    _, clipped, is_seen = project_boxes(calibration.boxes_to_velo(cam), calibration, size)
    return np.where(is_seen, _iou(clipped, image), 0.0)


def _iou(one: Boxes, other: Boxes) -> NDArray[np.float64]:
    """IoU of each pair of rectangles (N, 4); 0 of one that has no area."""
    both = np.minimum(one[:, 2:], other[:, 2:]) - np.maximum(one[:, :2], other[:, :2])
    shared = np.clip(both, 0, None).prod(axis=1)
    areas = [np.clip(box[:, 2:] - box[:, :2], 0, None).prod(axis=1) for box in (one, other)]
    return np.asarray(shared / np.maximum(areas[0] + areas[1] - shared, 1e-9))
