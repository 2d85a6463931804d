"""Which objects count at easy, moderate and hard, and why the others do not."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError
from fl3d.data.label_table import LabelTable
from fl3d.evaluation.protocol import Protocol

MIN_HEIGHT = (40, 25, 25)  # pixels; easy, moderate, hard
MAX_OCCLUSION = (0, 1, 2)
MAX_TRUNCATION = (0.15, 0.30, 0.50)
LAST_OCCLUSION, LAST_TRUNCATION = 3, 1.0  # the highest values that KITTI's labels have

Mask = NDArray[np.bool_]


class Reason(StrEnum):
    """Why an object of a class that counts is neither hit nor miss at a level; an object has the first that holds."""

    OUTSIDE = "outside the protocol's area"
    NO_BOX = "without a 2D box"
    LOW = "too low in the picture"
    NO_OCCLUSION = "occlusion beyond KITTI's 3"
    OCCLUDED = "too occluded"
    NO_TRUNCATION = "truncation beyond KITTI's 1"
    TRUNCATED = "too truncated"
    FAR = "too far away"
    FEW_POINTS = "too few points"


def reasons(
    gt: LabelTable,
    level: int,
    protocol: Protocol,
    beyond: Mask | None = None,
    points: NDArray[np.int64] | None = None,
) -> dict[Reason, Mask]:
    """Why ground truths are ignored at a level, whatever their class: (G,) for each reason that the protocol knows.

    Args:
        gt: ground truths.
        level: 0 easy, 1 moderate, 2 hard.
        protocol: what the level goes by.
        beyond: (G,) which lie outside the protocol's area; None: none.
        points: (G,) points of the LiDAR on each; needed where the protocol goes by points.

    Raises:
        ConfigError: the protocol goes by points, and there are none.
    """
    found = {} if beyond is None else {Reason.OUTSIDE: beyond}
    limits = protocol.level_limits
    if protocol.uses_picture:
        return found | _in_picture(gt, level, protocol.variant)
    if limits is None:
        return found
    if protocol.difficulty == "distance":
        return found | {Reason.FAR: distances(gt) > limits[level]}
    if points is None:
        raise ConfigError(
            "protocol.difficulty: points needs the clouds, which only a sweep has at hand; possible without: "
            "distance, none, image"
        )
    return found | {Reason.FEW_POINTS: points < limits[level]}


def _in_picture(gt: LabelTable, level: int, variant: str) -> dict[Reason, Mask]:
    """KITTI's own rules."""
    truncated, occluded = gt.values[:, 0], gt.values[:, 1]
    height = gt.values[:, 6] - gt.values[:, 4]
    minimum = MIN_HEIGHT[level]
    return {
        Reason.NO_BOX: height <= 0,
        Reason.LOW: height < minimum if variant == "A" else height <= minimum,
        Reason.NO_OCCLUSION: occluded > LAST_OCCLUSION,
        Reason.OCCLUDED: occluded > MAX_OCCLUSION[level],
        Reason.NO_TRUNCATION: truncated > LAST_TRUNCATION,
        Reason.TRUNCATED: truncated > MAX_TRUNCATION[level],
    }


def distances(table: LabelTable) -> NDArray[np.float64]:
    """How far away objects are over ground from the origin of their coordinates, metres: (N,).

    Of KITTI's labels that is the left colour camera's place, 0.27 m from the LiDAR.
    """
    return np.hypot(table.values[:, 10], table.values[:, 12])


def ground_truth_flags(
    gt: LabelTable, name: str, neighbours: Sequence[str], ignored: Mask
) -> NDArray[np.int8]:
    """0 counts, 1 ignored, -1 not there: (G,) for a class.

    Args:
        gt: ground truths.
        name: of the class.
        neighbours: types that are matched and never counted.
        ignored: (G,) which do not count at the level, whatever their class.
    """
    flags = np.full(len(gt.types), -1, dtype=np.int8)
    own = gt.of(name)
    flags[own] = np.where(ignored[own], 1, 0)
    for neighbour in neighbours:
        flags[gt.of(neighbour)] = 1
    return flags


def ignored_at(found: dict[Reason, Mask], n: int) -> Mask:
    """Which of n objects any reason holds for."""
    ignored = np.zeros(n, dtype=bool)
    for mask in found.values():
        ignored |= mask
    return ignored


def detection_flags(det: LabelTable, name: str, level: int, protocol: Protocol) -> NDArray[np.int8]:
    """0 counts, 1 ignored, -1 not there: (D,). Height is looked at before class, where the picture is."""
    flags = np.where(det.of(name), 0, -1).astype(np.int8)
    if protocol.uses_picture:
        flags[is_low(det, level)] = 1
    return flags


def is_low(det: LabelTable, level: int) -> Mask:
    """Which detections are lower than the minimum height, in whole pixels: (D,)."""
    height = np.abs(det.values[:, 4] - det.values[:, 6]).astype(np.int64)
    return height < MIN_HEIGHT[level]


def result_reasons(det: LabelTable, level: int, protocol: Protocol) -> dict[Reason, Mask]:
    """Why results are no false alarms at a level, whatever their class: (D,) for each reason."""
    if protocol.uses_picture:
        without = det.values[:, 6] == det.values[:, 4]
        return {Reason.NO_BOX: without, Reason.LOW: is_low(det, level)}
    return {Reason.FAR: is_far(det, level, protocol)}


def is_far(det: LabelTable, level: int, protocol: Protocol) -> Mask:
    """Which detections lie beyond a level that goes by distance, so that they are hits but never false alarms: (D,)."""
    limits = protocol.level_limits
    if protocol.difficulty != "distance" or limits is None:
        return np.zeros(len(det.types), dtype=bool)
    return distances(det) > limits[level]
