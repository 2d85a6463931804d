"""Change training frames at random: objects of other frames pasted in, flip, rotation, scale; for detectors of clouds.

Yan, Mao, Li: SECOND: Sparsely Embedded Convolutional Detection. Sensors 2018, §3.2.2; numbers as in PointRCNN's code.
All of it happens in the LiDAR frame; labels keep what is not a box in space, such as the 2D box, as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, options
from fl3d.core.typed import Count, NotNegative, Share, Whole
from fl3d.data.dataset import Frames
from fl3d.data.kitti import Frame
from fl3d.data.labels import Labels, joined
from fl3d.data.road import ROADS, road_height
from fl3d.geometry.boxes import Array, points_inside, rectangles_velo, wrap
from fl3d.geometry.iou import bev_iou

LEAST_HEIGHT, MOST_OCCLUDED, MOST_TRUNCATED = 25.0, 2, 0.5  # pixels; of KITTI's level hard
HEADROOM = 2.0  # metres above a pasted object, cleared of the scene's points


@dataclass(frozen=True)
class Object:
    """An object of a frame, to be pasted into others.

    Args:
        points_velo: (P, 4) inside the box.
        box_velo: (7,).
        label: one row.
    """

    points_velo: NDArray[np.float32]
    box_velo: Array
    label: Labels


@dataclass(frozen=True)
class ObjectSampling:
    """Which objects of other frames are pasted into a frame.

    Args:
        classes: of the objects.
        tries: fewest and most objects that are tried in one frame; those that find room stay.
        attempts: draws at most.
        hard_share: of the draws look for an object of few points, the others for one of many.
        hard_points: an object with more is not hard.
        min_points: an object with fewer is not taken.
        gap: metres that lengths and widths are enlarged by where an object is tried against the others.
        range_velo: x0, y0, z0, x1, y1, z1 in metres; objects that stand outside are not taken.
        road: ``fitted`` to the frame's points, or ``planes``, files as KITTI's users share them.

    Raises:
        ConfigError: a road that does not exist.
    """

    classes: Sequence[str]
    tries: tuple[Whole, Whole]
    attempts: Count
    hard_share: Share
    hard_points: Whole
    min_points: Whole
    gap: NotNegative
    range_velo: Sequence[float]
    road: str

    def __post_init__(self) -> None:
        if self.road not in ROADS:
            raise ConfigError(
                f"augment.objects.road: no choice '{self.road}'. {options(self.road, ROADS)}"
            )

    def objects(self, frame: Frame) -> list[Object]:
        """What of a frame may be pasted into others."""
        labels = frame.labels
        height = labels.boxes_image[:, 3] - labels.boxes_image[:, 1]
        fit = np.isin(labels.types, self.classes) & (height >= LEAST_HEIGHT)
        fit &= (labels.occluded <= MOST_OCCLUDED) & (labels.truncated <= MOST_TRUNCATED)
        rows = np.flatnonzero(fit)
        boxes = frame.calibration.boxes_to_velo(labels.boxes_cam[rows])
        inside = points_inside(frame.points_velo, boxes)
        enough = (inside.sum(axis=1) >= self.min_points) & self._within(boxes)
        return [
            Object(
                frame.points_velo[inside[i]],
                boxes[i],
                labels.select(np.arange(len(labels)) == rows[i]),
            )
            for i in np.flatnonzero(enough)
        ]

    def _within(self, boxes_velo: Array) -> NDArray[np.bool_]:
        low, high = np.array(self.range_velo[:2]), np.array(self.range_velo[3:5])
        return np.asarray(((boxes_velo[:, :2] >= low) & (boxes_velo[:, :2] < high)).all(axis=1))


class Augmentation:
    """Random changes of training frames, in this order: objects, flip, turn, scale.

    Args:
        flip: probability of left for right.
        turn: largest, in degrees, about the sensor.
        scale: largest change of scale, as a share.
        objects: what is pasted in; None: nothing.
    """

    def __init__(
        self,
        flip: Share,
        turn: NotNegative,
        scale: NotNegative,
        objects: ObjectSampling | None = None,
    ) -> None:
        self.flip, self.turn, self.scale, self.objects = flip, turn, scale, objects
        self._bank: dict[int, list[Object]] = {}

    def __call__(self, frames: Frames, index: int, rng: np.random.Generator) -> Frame:
        """A frame, changed.

        Args:
            frames: of the training split.
            index: which.
            rng: all randomness.
        """
        frame = frames[index]
        if self.objects is not None:
            frame = self._put_in(frame, frames, self.objects, rng)
        points = frame.points_velo.copy()
        is_box = frame.labels.types != "DontCare"
        boxes = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[is_box])
        if rng.random() < self.flip:
            points[:, 1] *= -1
            boxes[:, [1, 6]] *= -1
        _turn(points, boxes, np.deg2rad(rng.uniform(-self.turn, self.turn)))
        factor = rng.uniform(1 - self.scale, 1 + self.scale)
        points[:, :3] *= factor
        boxes[:, :6] *= factor
        boxes_cam = frame.labels.boxes_cam.copy()
        boxes_cam[is_box] = frame.calibration.boxes_to_cam(boxes)
        return replace(frame, points_velo=points, labels=replace(frame.labels, boxes_cam=boxes_cam))

    def _put_in(
        self, frame: Frame, frames: Frames, rule: ObjectSampling, rng: np.random.Generator
    ) -> Frame:
        real = frame.labels.types != "DontCare"
        taken = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[real])
        points, labels = frame.points_velo, [frame.labels]
        tries, ground = rng.integers(rule.tries[0], rule.tries[1]), None
        for _ in range(rule.attempts):
            if tries == 0:
                break
            other = int(rng.integers(len(frames)))
            is_hard, pick = rng.random() < rule.hard_share, rng.random()
            fit = [
                o
                for o in self._objects(frames, other)
                if (len(o.points_velo) <= rule.hard_points) == is_hard
            ]
            if not fit:
                continue
            tries -= 1
            one = fit[int(pick * len(fit))]
            ground = road_height(frame, frames.folder, rule.road) if ground is None else ground
            rise = ground(one.box_velo[:2]) - one.box_velo[2]
            box = one.box_velo + np.array([0, 0, rise, 0, 0, 0, 0])
            enlarged = np.array([0, 0, 0, 0, rule.gap, rule.gap, 0])
            if (
                bev_iou(rectangles_velo(box[None] + enlarged), rectangles_velo(taken + enlarged))
                > 0
            ).any():
                continue
            cleared = box[None] + np.array([0, 0, 0, HEADROOM, 0, 0, 0])
            own = one.points_velo + np.array([0, 0, rise, 0], dtype=np.float32)
            points = np.concatenate([points[~points_inside(points, cleared)[0]], own])
            taken = np.concatenate([taken, box[None]])
            labels.append(replace(one.label, boxes_cam=frame.calibration.boxes_to_cam(box[None])))
        return replace(frame, points_velo=points, labels=joined(labels))

    def _objects(self, frames: Frames, index: int) -> list[Object]:
        assert self.objects is not None
        if index not in self._bank:
            self._bank[index] = self.objects.objects(frames[index])
        return self._bank[index]


def _turn(points: NDArray[np.float32], boxes: Array, angle: float) -> None:
    cos, sin = np.cos(angle), np.sin(angle)
    for rows in (points, boxes):
        x, y = rows[:, 0].copy(), rows[:, 1].copy()
        rows[:, 0], rows[:, 1] = x * cos - y * sin, x * sin + y * cos
    boxes[:, 6] = wrap(boxes[:, 6] + angle)
