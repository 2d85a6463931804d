"""KITTI labels of a simulated scene: boxes, truncation, occlusion, and regions that nobody annotated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fl3d.data.calibration import Calibration
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.data.projection import project_boxes
from fl3d.simulator.echoes import Returns
from fl3d.simulator.site import Thing
from fl3d.simulator.solids import Float

# Share of an object that can be seen, from which it is called visible, or partly occluded (else largely). In KITTI's
# labels the classes part where 8 % and 53 % of a box lie behind nearer boxes.
VISIBLE, PARTLY = 0.92, 0.47
LOWEST_SEEN = 0.18  # less of it seen: not annotated
UNKNOWN = 0.25  # share of the objects that leave the picture by more than half whose occlusion is called unknown
MIN_HEIGHT, LOST_HEIGHT = (
    14.0,
    6.0,
)  # pixels: smaller objects become DontCare regions, still smaller ones nothing
MIN_WIDTH = 10.0  # pixels, of what is in the picture
FAR, GONE = 50.0, 85.0  # metres: from here on fewer and fewer are annotated, and from there on none
IGNORED = (-1.0, -1.0, -10.0)  # truncation, occlusion and angle of a DontCare region
IGNORED_BOX = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)


def things_boxes(things: Sequence[Thing]) -> Float:
    """``boxes_velo`` (N, 7) of things."""
    return np.array(
        [[*t.position, t.size[2], t.size[1], t.size[0], t.yaw] for t in things]
    ).reshape(-1, 7)


def annotate(
    things: Sequence[Thing],
    returns: Returns,
    calibration: Calibration,
    image_size: tuple[int, int],
    rng: np.random.Generator,
) -> Labels:
    """Labels of what can be seen, nearest last as it comes; DontCare regions at the end.

    2D boxes are projected 3D boxes cut at the picture's border, and truncation is the share that is cut off: so are
    KITTI's (correlation with the labels 0.999).

    Args:
        things: in the order of ``returns``.
        returns: of the scan; its ``seen / alone`` gives the occlusion.
        calibration: of the frame.
        image_size: (width, height).
        rng: which occlusions are unknown, and which far objects are not annotated.
    """
    boxes_velo = things_boxes(things)
    full, clipped, ahead = project_boxes(boxes_velo, calibration, image_size)
    area, inside = _area(full), _area(clipped)
    truncated = 1 - np.divide(inside, area, out=np.zeros_like(area), where=area > 0)
    share = returns.seen / np.maximum(returns.alone, 1)
    occluded = np.where(share >= VISIBLE, 0, np.where(share >= PARTLY, 1, 2))
    occluded = np.where((truncated > 0.5) & (rng.random(len(things)) < UNKNOWN), 3, occluded)
    height = clipped[:, 3] - clipped[:, 1]
    distance = np.hypot(boxes_velo[:, 0], boxes_velo[:, 1])
    near = distance < FAR + (GONE - FAR) * rng.random(len(things)) ** 1.5
    in_picture = ahead & (clipped[:, 2] - clipped[:, 0] >= np.minimum(MIN_WIDTH, height / 4))
    annotated = (
        in_picture & (share >= LOWEST_SEEN) & (height >= MIN_HEIGHT) & (returns.counts > 0) & near
    )
    lost = in_picture & ~annotated & (height >= LOST_HEIGHT) & (returns.seen > 0)
    boxes_cam = calibration.boxes_to_cam(boxes_velo)
    alpha = boxes_cam[:, 6] - np.arctan2(boxes_cam[:, 0], boxes_cam[:, 2])
    alpha -= 2 * np.pi * np.round(alpha / (2 * np.pi))
    columns = np.column_stack(
        [truncated, occluded, alpha, clipped, boxes_cam[:, 3:6], boxes_cam[:, :3], boxes_cam[:, 6]]
    )
    regions = _regions(clipped[lost])
    ignored = np.array([[*IGNORED, *region, *IGNORED_BOX] for region in regions]).reshape(-1, 14)
    kinds = [t.kind for t, kept in zip(things, annotated, strict=True) if kept] + [
        "DontCare"
    ] * len(ignored)
    return labels_from_columns(kinds, np.concatenate([columns[annotated], ignored]), scored=False)


def _area(boxes: Float) -> Float:
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))


def _regions(boxes: Float) -> list[Float]:
    """Boxes that touch, drawn together as one."""
    regions: list[Float] = []
    for box in boxes:
        merged = box.copy()
        apart = []
        for region in regions:
            touches = (region[:2] <= merged[2:]).all() and (merged[:2] <= region[2:]).all()
            if touches:
                merged = np.concatenate(
                    [np.minimum(region[:2], merged[:2]), np.maximum(region[2:], merged[2:])]
                )
            else:
                apart.append(region)
        regions = [*apart, merged]
    return regions
