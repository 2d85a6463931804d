"""Anchors of VoxelNet: the grid, the matching and the box code (Zhou and Tuzel 2018, §2.2 and §3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, options
from fl3d.core.typed import Positive, Share
from fl3d.geometry.boxes import Array, rectangles_velo, standup
from fl3d.geometry.iou import bev_iou, image_iou

GRIDS = ("centers", "linspace")
IOUS = ("standup", "rotated")


@dataclass(frozen=True)
class Anchors:
    """Boxes of one size at every output cell, each turned to 0 and to 90 degrees.

    Args:
        range_velo: x0, y0, z0, x1, y1, z1 in metres.
        shape: output cells along y, x.
        size: h, w, l in metres.
        z: of the anchors' bottom, metres.
        grid: ``centers`` puts anchors at cell centres; ``linspace`` spaces them evenly from border to border,
            as the paper's code does.
        positive: an anchor above this overlap is positive; so is each object's best anchor.
        negative: an anchor below this overlap with every object is negative; those between are ignored.
        iou: between ``standup`` hulls (the code) or ``rotated`` rectangles.
        iou_plus_one: add one metre to every extent in the overlap (a quirk of the code).
    """

    range_velo: Sequence[float]
    shape: tuple[int, int]
    size: tuple[Positive, Positive, Positive]
    z: float
    grid: str
    positive: Share
    negative: Share
    iou: str
    iou_plus_one: bool

    def __post_init__(self) -> None:
        for key, value, possible in (("grid", self.grid, GRIDS), ("iou", self.iou, IOUS)):
            if value not in possible:
                raise ConfigError(
                    f"detector.anchors.{key}: no choice '{value}'. {options(value, possible)}"
                )
        if self.iou == "rotated" and self.iou_plus_one:
            raise ConfigError("detector.anchors.iou_plus_one needs iou=standup")

    @cached_property
    def boxes_velo(self) -> NDArray[np.float64]:
        """(Y * X * 2, 7), the two headings innermost."""
        ys, xs = (
            self._line(self.range_velo[a], self.range_velo[a + 3], n)
            for a, n in ((1, self.shape[0]), (0, self.shape[1]))
        )
        y, x, yaw = np.meshgrid(ys, xs, [0.0, np.pi / 2], indexing="ij")
        rest = np.broadcast_to([self.z, *self.size], (x.size, 4))
        return np.column_stack([x.ravel(), y.ravel(), rest, yaw.ravel()])

    def _line(self, low: float, high: float, count: int) -> Array:
        if self.grid == "linspace":
            return np.linspace(low, high, count)
        return low + (np.arange(count) + 0.5) * (high - low) / count

    @cached_property
    def _hulls(self) -> NDArray[np.float64]:
        return self._hulls_of(self.boxes_velo)

    @cached_property
    def _sides(self) -> NDArray[np.float64]:
        """(4, A): the numbers of one side lie together, which is faster to compare."""
        return np.ascontiguousarray(self._hulls.T)

    def _hulls_of(self, boxes: Array) -> NDArray[np.float64]:
        grow = np.array([0, 0, 1, 1]) if self.iou_plus_one else np.zeros(4)
        return standup(rectangles_velo(boxes)) + grow

    def overlaps(self, box: Array) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Anchors whose hull meets that of an object (7,), and their overlap with it; all others have none."""
        low_x, low_y, high_x, high_y = self._sides
        hull = self._hulls_of(box[None])
        (x1, y1, x2, y2) = hull[0]
        near = np.flatnonzero((low_x < x2) & (high_x > x1) & (low_y < y2) & (high_y > y1))
        if self.iou == "rotated":
            return near, bev_iou(
                rectangles_velo(self.boxes_velo[near]), rectangles_velo(box[None])
            )[:, 0]
        return near, image_iou(self._hulls[near], hull)[:, 0]

    def assign(
        self, boxes: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Match anchors to objects.

        Args:
            boxes: (N, 7) objects.

        Returns:
            positive anchors (P,), the object of each (P,), and which anchors are negative (A,).
        """
        count = len(self.boxes_velo)
        best, owner, positive = (
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=bool),
        )
        tops = []
        for n, box in enumerate(boxes):
            near, overlap = self.overlaps(box)
            better = overlap > best[near]
            best[near[better]], owner[near[better]] = overlap[better], n
            if overlap.any():
                tops.append((near[overlap.argmax()], n))
        positive[best > self.positive] = True
        for anchor, n in tops:
            positive[anchor], owner[anchor] = True, n
        chosen = np.flatnonzero(positive)
        return chosen, owner[chosen], (best < self.negative) & ~positive


class ClassAnchors:
    """The anchors of each class at every output cell: those of the first class at a cell, then those of the next.

    An anchor is matched with the objects of its own class alone; what it finds is of that class.

    Args:
        of: anchors of each class.
    """

    def __init__(self, of: Sequence[Anchors]) -> None:
        self.of = tuple(of)
        boxes = np.stack([one.boxes_velo.reshape(-1, 2, 7) for one in self.of], axis=1)
        self.boxes_velo = boxes.reshape(
            -1, 7
        )  # of a cell: class by class, each turned to 0 and to 90 degrees
        self.kinds = np.tile(np.repeat(np.arange(len(self.of)), 2), len(boxes))

    def assign(
        self, boxes: Array, kinds: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Match anchors to objects, see ``Anchors.assign``.

        Args:
            boxes: (N, 7) objects.
            kinds: (N,) index of each one's class.
        """
        chosen, owners = [], []
        negative = np.zeros(len(self.boxes_velo), dtype=bool)
        for number, anchors in enumerate(self.of):
            place, objects = np.flatnonzero(self.kinds == number), np.flatnonzero(kinds == number)
            own, owner, below = anchors.assign(boxes[objects])
            chosen.append(place[own])
            owners.append(objects[owner])
            negative[place] = below
        every = np.concatenate(chosen)
        order = np.argsort(every, kind="stable")
        return every[order], np.concatenate(owners)[order], negative


def encode_boxes(boxes: Array, anchors: Array) -> NDArray[np.float64]:
    """Residuals dx, dy over the anchor's diagonal, dz over its height, log size ratios h, w, l, and dyaw.

    Args:
        boxes: (N, 7) ``boxes_velo``.
        anchors: (N, 7) ``boxes_velo``.
    """
    diagonal = np.hypot(anchors[:, 4], anchors[:, 5])[:, None]
    return np.column_stack(
        [
            (boxes[:, :2] - anchors[:, :2]) / diagonal,
            (boxes[:, 2] - anchors[:, 2]) / anchors[:, 3],
            np.log(boxes[:, 3:6] / anchors[:, 3:6]),
            boxes[:, 6] - anchors[:, 6],
        ]
    )


def decode_boxes(residuals: Array, anchors: Array) -> NDArray[np.float64]:
    """Inverse of ``encode_boxes``; sizes are held within exp(+-4) of the anchor's, whatever a network says."""
    diagonal = np.hypot(anchors[:, 4], anchors[:, 5])[:, None]
    return np.column_stack(
        [
            residuals[:, :2] * diagonal + anchors[:, :2],
            residuals[:, 2] * anchors[:, 3] + anchors[:, 2],
            np.exp(np.clip(residuals[:, 3:6], -4, 4)) * anchors[:, 3:6],
            residuals[:, 6] + anchors[:, 6],
        ]
    )
