"""Frames of a split, in a seeded order, with the targets' rules applied (paper, §VI-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.core.typed import Whole
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.label_parser import kitti_spelling
from fl3d.data.labels import check_sizes
from fl3d.geometry.boxes import count_points_inside


@dataclass(frozen=True)
class TargetRule:
    """Which labels become training targets. Evaluation always uses all labels.

    Args:
        classes: label types that count as positive.
        min_points: boxes holding fewer LiDAR points are dropped (paper: "fewer than 10").
    """

    classes: tuple[str, ...] = ("Car",)
    min_points: Whole = 10

    def boxes_velo(self, frame: Frame) -> NDArray[np.float64]:
        """Boxes to train on: (N, 7) ``boxes_velo``.

        Raises:
            DataError: an object of the classes has no size.
        """
        classes = [kitti_spelling(name) for name in self.classes]
        check_sizes(frame.labels, classes, frame.label_file)
        boxes = frame.calibration.boxes_to_velo(
            frame.labels.boxes_cam[np.isin(frame.labels.types, classes)]
        )
        enough = count_points_inside(frame.points_velo, boxes) >= self.min_points
        return boxes[enough]


class Frames:
    """The frames of one split, read on demand and kept in memory up to a limit.

    Args:
        folder: where they lie.
        ids: which, in the split's order.
        cache: how many cropped frames stay in memory (a real one takes about 300 kB).
    """

    def __init__(self, folder: KittiFolder, ids: Sequence[str], cache: int) -> None:
        self.folder = folder
        self.ids = tuple(ids)
        self._cache_size = cache
        self._cache: dict[str, Frame] = {}

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        frame_id = self.ids[index]
        frame = self._cache.get(frame_id)
        if frame is None:
            frame = self.folder.frame(frame_id)
            if len(self._cache) < self._cache_size:
                self._cache[frame_id] = frame
        return frame


def frames_with(folder: KittiFolder, ids: Sequence[str], types: Sequence[str]) -> list[str]:
    """Those frames whose labels name any of these types.

    Raises:
        DataError: there is none.
    """
    found = [i for i in ids if np.isin(folder.read_labels(i).types, types).any()]
    if not found:
        raise DataError(
            f"no training frame holds a label of type {' or '.join(types)}", folder.root
        )
    return found


def subset(ids: Sequence[str], count: int | None, seed: int) -> list[str]:
    """A seeded random subset, in the split's order; all where ``count`` is None or not below the size."""
    if count is None or count >= len(ids):
        return list(ids)
    chosen = np.sort(np.random.default_rng([seed, len(ids)]).permutation(len(ids))[:count])
    return [ids[i] for i in chosen]


def epoch_order(n_frames: int, repeat: int, seed: int, epoch: int) -> NDArray[np.int64]:
    """Order of the frames in one epoch: each of ``repeat`` passes is a fresh permutation.

    Depends on nothing but its arguments, so a resumed or forked stage sees the same order.
    """
    passes = [np.random.default_rng([seed, epoch, k]).permutation(n_frames) for k in range(repeat)]
    return np.concatenate(passes)
