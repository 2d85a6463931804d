"""Frames of a split, in a seeded order, with the targets' rules applied (paper, §VI-A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, DataError
from fl3d.core.typed import Whole
from fl3d.data.classes import CARS, class_of
from fl3d.data.kitti import Frame, KittiFolder, Stamp
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
        """Boxes to train on, of a detector of one class: (N, 7) ``boxes_velo``.

        Raises:
            DataError: an object of the classes has no size.
        """
        return self.objects(frame, CARS)[0]

    def objects(
        self, frame: Frame, classes: Sequence[str], least: Mapping[str, int] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Objects to train on.

        Args:
            frame: one frame.
            classes: that are detected.
            least: ``min_points`` of those classes that have their own.

        Returns:
            (N, 7) ``boxes_velo``, and (N,) index into ``classes`` of the class that each is learnt as.

        Raises:
            DataError: an object of the classes has no size.
        """
        learnt = self._learnt_as(classes)
        check_sizes(frame.labels, list(learnt), frame.label_file)
        own = np.isin(frame.labels.types, list(learnt))
        boxes = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[own])
        kinds = np.array([learnt[str(t)] for t in frame.labels.types[own]], dtype=np.int64)
        needed = np.array([(least or {}).get(name, self.min_points) for name in classes])
        enough = count_points_inside(frame.points_velo, boxes) >= needed[kinds]
        return boxes[enough], kinds[enough]

    def check(self, classes: Sequence[str]) -> None:
        """Refuse classes that nothing is learnt of, and label types that are of none; cars alone have any.

        Raises:
            ConfigError: naming the key.
        """
        if tuple(classes) == CARS:
            return
        key, types = "detector.targets.classes", [kitti_spelling(name) for name in self.classes]
        wanted = ",".join(classes)
        for name in classes:
            if name not in types:
                raise ConfigError(
                    f"{key}: {types} do not hold {name}, which classes name; give {key}=[{wanted}]"
                )
        for label in types:
            if class_of(label, classes) is None:
                raise ConfigError(
                    f"{key}: {label} is none of classes=[{wanted}], nor a neighbour of one; "
                    f"give {key}=[{wanted}]"
                )

    def _learnt_as(self, classes: Sequence[str]) -> dict[str, int]:
        """Index of the class that each type of labels is learnt as."""
        types = [kitti_spelling(name) for name in self.classes]
        found = {label: class_of(label, classes) for label in types}
        return {label: number for label, number in found.items() if number is not None}


class Frames:
    """The frames of one split, read on demand and kept in memory up to a limit.

    What is kept is the process's, so that stages that follow one another on the same frames read them once.

    Args:
        folder: where they lie.
        ids: which, in the split's order.
        cache: how many cropped frames the process keeps (a real one takes about 300 kB); 0: it neither keeps any nor
            looks at those it has.
    """

    def __init__(self, folder: KittiFolder, ids: Sequence[str], cache: int) -> None:
        self.folder = folder
        self.ids = tuple(ids)
        self._cache_size = cache

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        if self._cache_size == 0:
            return self.folder.frame(self.ids[index])
        return _kept.frame(self.folder, self.ids[index], self._cache_size)


class _Kept:
    """Frames that this process keeps, of one folder as it is read; each as long as its files are what they were."""

    def __init__(self) -> None:
        self._reading: object = None
        self._frames: dict[str, tuple[Stamp, Frame]] = {}

    def frame(self, folder: KittiFolder, frame_id: str, limit: int) -> Frame:
        """A frame, kept or read."""
        if folder.reading != self._reading:
            self._reading, self._frames = folder.reading, {}
        stamp = folder.stamp(frame_id)
        of, frame = self._frames.get(frame_id, (None, None))
        if frame is not None and of == stamp:
            return folder.with_found(frame)
        frame = folder.frame(frame_id)
        if frame_id in self._frames or len(self._frames) < limit:
            self._frames[frame_id] = stamp, frame
        return frame


_kept = _Kept()


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
