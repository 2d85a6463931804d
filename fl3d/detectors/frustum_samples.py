"""What Frustum ConvNet's two stages are shown: points behind 2D boxes, and points in and about 3D boxes.

Frustums stand at the camera, with the LiDAR's axes (x forward, y left, z up) turned so that x points through the middle
of the 2D box; the second stage's stand at the box's centre, and x lies across it, as its code's depth does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fl3d.core.typed import NotNegative, Share, make
from fl3d.data.kitti import Frame
from fl3d.detectors.base import Sample
from fl3d.detectors.frustums import enlarged, jittered, moved, rays, sampled, turned
from fl3d.geometry.boxes import Array, points_inside

LEAST_HEIGHT, LEAST_WIDTH = 5.0, 1.0  # pixels of a 2D box that is looked at
ACROSS = np.pi / 2  # from a box's yaw to the second stage's axis


@dataclass(frozen=True)
class Jitter:
    """How training samples differ from the labels.

    Args:
        shift: of a 2D box, share of its size; of a refined box likewise.
        size: change of its size, as a share.
        yaw: of a refined box, degrees.
        depth: spread of the shift along the axis, as a share of the object's diagonal; normal.
        most: largest such shift, in the same unit, or in metres for refined boxes.
        flip: probability of left for right.
        turn: of object and points about the vertical through the frustum's origin, degrees at most: the report's text
            has it, its code has not. It takes far objects off the axis: from 5 degrees on many hold no place.
        scale: of object and points, share at most: likewise in the text alone.
    """

    shift: NotNegative
    size: NotNegative
    yaw: NotNegative
    depth: NotNegative
    most: NotNegative
    flip: Share
    turn: NotNegative
    scale: NotNegative

    def changed(self, points: Array, box: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """An object and its points flipped, turned and scaled at random: (N, 3), (7,)."""
        if rng.random() < self.flip:
            points, box = points * [1, -1, 1], box * [1, -1, 1, 1, 1, 1, -1]
        if self.turn:
            angle = np.deg2rad(rng.uniform(-self.turn, self.turn))
            points, box = turned(points, angle), moved(box[None], np.zeros(3), angle)[0]
        if self.scale:
            factor = 1 + rng.uniform(-self.scale, self.scale)
            points, box = points * factor, box * [*[factor] * 6, 1]
        return points, box

    def along(self, box: Array, unit: float, rng: np.random.Generator) -> float:
        """A shift along the axis; ``most`` is in so many metres."""
        spread = self.depth * np.hypot(box[4], box[5])
        return float(np.clip(rng.normal(0, spread), -self.most * unit, self.most * unit))


@dataclass
class FrustumView:
    """Points behind 2D boxes.

    Args:
        reach: first and last depth, metres.
        nearest: points nearer to the LiDAR are left out, metres.
        points: of a frustum.
        jitter: in training.
    """

    reach: tuple[float, float]
    nearest: float
    points: int
    jitter: Jitter

    def learn(
        self,
        frame: Frame,
        boxes_image: Array,
        objects: Array,
        kinds: NDArray[np.int64],
        rng: np.random.Generator,
    ) -> Sample:
        """Training samples: (N, 4) 2D boxes, (N, 7) ``boxes_velo`` of their objects, (N,) size classes."""
        boxes_image = jittered(boxes_image, self.jitter.shift, self.jitter.size, rng)
        rows, boxes, kept = [], [], []
        seen = _Seen(frame, boxes_image, self.nearest)
        for k, own in seen.behind():
            box = moved(objects[k : k + 1], -seen.origin, -seen.angle[k])[0]
            low, high = self.reach
            if not low <= box[0] < high:
                continue
            points, box = self.jitter.changed(sampled(own, self.points, rng), box, rng)
            shift = self.jitter.along(box, float(np.hypot(box[4], box[5])), rng)
            shift = float(np.clip(box[0] + shift, low, high)) - box[0]
            rows.append(points + [shift, 0, 0])
            boxes.append(box + [shift, *[0] * 6])
            kept.append(k)
        return self._sample(rows, seen, kept) | {
            "boxes": _table(boxes, 7),
            "kinds": kinds[np.array(kept, dtype=np.int64)],
        }

    def look(
        self,
        frame: Frame,
        image_boxes: Array,
        kinds: NDArray[np.int64],
        rng: np.random.Generator,
    ) -> Sample:
        """What lies behind the 2D boxes of a detector, with their scores, and size classes: (N, 5), (N,)."""
        seen, rows, kept = _Seen(frame, image_boxes[:, :4], self.nearest), [], []
        for k, own in seen.behind():
            if (own[:, 0] < self.reach[1]).any():
                rows.append(sampled(own, self.points, rng))
                kept.append(k)
        return self._sample(rows, seen, kept) | {
            "image_scores": image_boxes[kept, 4].astype(np.float32),
            "boxes_image": seen.boxes[kept],
            "kinds": kinds[np.array(kept, dtype=np.int64)],
        }

    def _sample(self, rows: list[Array], seen: _Seen, kept: list[int]) -> Sample:
        return {
            "points": _table(rows, self.points, 3),
            "angle": seen.angle[kept].astype(np.float32),
            "slope": seen.slope[kept].astype(np.float32),
            "origin": np.tile(seen.origin, (len(kept), 1)).astype(np.float32),
        }


class _Seen:
    """The points of a frame that the camera sees, and the rays through the middles of 2D boxes (N, 4)."""

    def __init__(self, frame: Frame, boxes_image: Array, nearest: float) -> None:
        width, height = frame.image_size
        self.boxes = np.clip(boxes_image, 0, np.array([width - 1, height - 1] * 2))
        points_velo = cloud_velo(frame, nearest).astype(np.float64)
        pixels, depth = frame.calibration.points_to_image(
            frame.calibration.points_to_cam(points_velo)
        )
        self._points_velo = points_velo[depth > 0]
        self._columns, self._rows = np.ascontiguousarray(pixels[depth > 0].T)
        self.origin, directions = rays(
            frame.calibration, (self.boxes[:, :2] + self.boxes[:, 2:]) / 2
        )
        self.angle = np.arctan2(directions[:, 1], directions[:, 0])
        self.slope = directions[:, 2] / np.hypot(directions[:, 0], directions[:, 1])

    def behind(self) -> list[tuple[int, Array]]:
        """Index of each 2D box that is large enough and holds points, and these points in its frustum's frame."""
        found = []
        for k, box in enumerate(self.boxes):
            inside = (self._columns >= box[0]) & (self._columns <= box[2])
            inside &= (self._rows >= box[1]) & (self._rows <= box[3])
            is_large = box[3] - box[1] >= LEAST_HEIGHT and box[2] - box[0] >= LEAST_WIDTH
            if is_large and inside.any():
                found.append((k, turned(self._points_velo[inside] - self.origin, -self.angle[k])))
        return found


@dataclass
class BoxView:
    """Points in and about 3D boxes, for the second stage.

    Args:
        enlarge: a box by this factor.
        nearest: points nearer to the LiDAR are left out, metres.
        points: of a box.
        jitter: in training.
    """

    enlarge: float
    nearest: float
    points: int
    jitter: Jitter

    @classmethod
    def of(cls, options: Mapping[str, Any], nearest: float) -> Self:
        """From the options of the detector's ``refine``."""
        return cls(
            options["enlarge"],
            nearest,
            options["points"],
            make(Jitter, options["jitter"], "detector.refine.jitter"),
        )

    def learn(
        self, frame: Frame, objects: Array, kinds: NDArray[np.int64], rng: np.random.Generator
    ) -> Sample:
        """Training samples: jittered objects (N, 7) of size classes (N,), as if the first stage had found them."""
        rows, boxes, kept = [], [], []
        found = self._jittered(objects, rng)
        for k, own in self._inside(cloud_velo(frame, self.nearest).astype(np.float64), found):
            target = moved(objects[k : k + 1], -_center(found[k]), -found[k, 6] - ACROSS)[0]
            points, target = self.jitter.changed(sampled(own, self.points, rng), target, rng)
            shift = self.jitter.along(target, 1.0, rng)
            rows.append(points + [shift, 0, 0])
            boxes.append(target + [shift, *[0] * 6])
            kept.append(k)
        return {
            "points": _table(rows, self.points, 3),
            "boxes": _table(boxes, 7),
            "kinds": kinds[np.array(kept, dtype=np.int64)],
        }

    def look(self, points_velo: Array, boxes_velo: Array) -> tuple[NDArray[np.float32], list[int]]:
        """Points (K, points, 3) of those boxes that hold any, the first ones repeated, and which boxes these are."""
        rows, kept = [], []
        for k, own in self._inside(points_velo, boxes_velo):
            rows.append(own[np.arange(self.points) % len(own)])
            kept.append(k)
        return _table(rows, self.points, 3), kept

    def _inside(self, points_velo: Array, boxes_velo: Array) -> list[tuple[int, Array]]:
        """Index of each box that holds points once it is enlarged, and these points as it sees them."""
        inside = points_inside(points_velo, enlarged(boxes_velo, self.enlarge))
        return [
            (k, turned(points_velo[mask] - _center(box), -box[6] - ACROSS))
            for k, (box, mask) in enumerate(zip(boxes_velo, inside, strict=True))
            if mask.any()
        ]

    def _jittered(self, objects: Array, rng: np.random.Generator) -> Array:
        rule, n, found = self.jitter, len(objects), objects.copy()
        shift = found[:, [5, 4, 3]] * self.enlarge * rng.uniform(-rule.shift, rule.shift, (n, 3))
        for k in range(n):
            found[k, :3] += turned(shift[k : k + 1], found[k, 6])[0]
        found[:, 3:6] *= 1 + rng.uniform(-rule.size, rule.size, (n, 3))
        found[:, 6] += np.deg2rad(rng.uniform(-rule.yaw, rule.yaw, n))
        return found


def cloud_velo(frame: Frame, nearest: float) -> NDArray[np.float32]:
    """The points of a frame that are not too near, without their reflectance: (N, 3)."""
    return frame.points_velo[frame.points_velo[:, 0] > nearest, :3]


def _center(box_velo: Array) -> Array:
    return np.asarray(box_velo[:3] + [0, 0, box_velo[3] / 2])


def _table(rows: list[Array], *shape: int) -> NDArray[np.float32]:
    return np.array(rows, dtype=np.float32).reshape(-1, *shape)
