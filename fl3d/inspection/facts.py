"""What is seen in a folder of frames, gathered once; findings and summaries are made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.calibration import Calibration
from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import Labels, check_sizes, labels_from_columns
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.validation import Validation
from fl3d.geometry.boxes import count_points_inside
from fl3d.inspection.wanted import Wanted

EVERY = (
    37  # of a cloud's points the place is told from; prime, so that no ring of a scanner is missed
)

NOTHING = np.zeros((0, 14))

T = TypeVar("T")


@dataclass(frozen=True)
class Beside:
    """What lies beside a frame's cloud; None is what cannot be read.

    Args:
        labels: of the frame.
        calibration: of the frame.
        image_size: (width, height) in pixels.
        picture: its file's name ending, or None where there is no picture.
    """

    labels: Labels | None
    calibration: Calibration | None
    image_size: tuple[int, int] | None
    picture: str | None

    @property
    def whole(self) -> tuple[Labels, Calibration, tuple[int, int]] | None:
        """Labels, calibration and size, where all three can be read."""
        if self.labels is None or self.calibration is None or self.image_size is None:
            return None
        return self.labels, self.calibration, self.image_size


@dataclass(frozen=True)
class Cloud:
    """What was seen of a frame's cloud.

    Args:
        points: in the file that can be used.
        dropped: not finite, left out.
        kept: by ``data.crop``.
        in_range: of those kept, by detector.
        center: median x, y, z in metres.
        reach: metres from the sensor within which 95 % of the points lie.
        spread: likewise, from the centre.
        reflectance: least and largest.
        held: (N,) points kept on each labelled object; 0 where it has no 3D box.
        upper: (N,) of them in the upper half of its box.
        targets: by what a detector learns from, (N,) which labels it does; a sweep may have one detector of several.
    """

    points: int
    dropped: int
    kept: int
    in_range: Mapping[str, int]
    center: tuple[float, float, float]
    reach: float
    spread: float
    reflectance: tuple[float, float]
    held: NDArray[np.int64]
    upper: NDArray[np.int64]
    targets: Mapping[Wanted, NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class Facts:
    """A folder as it was found.

    Args:
        kitti: the folder.
        splits: ids by name of the split.
        beside: of every frame of a split.
        clouds: of those frames whose clouds were looked at.
        wanted: what detectors learn from.
        protocol: what an AP stands for.
        problems: what could not be read.
    """

    kitti: KittiFolder
    splits: Mapping[str, tuple[str, ...]]
    beside: Mapping[str, Beside]
    clouds: Mapping[str, Cloud]
    wanted: tuple[Wanted, ...]
    protocol: Protocol
    problems: Sequence[DataError] = field(default=())

    def labels(self, split: str) -> list[Labels]:
        """Of the frames of a split that have some that can be read."""
        found = (self.beside[i].labels for i in self.splits[split])
        return [labels for labels in found if labels is not None]

    @cached_property
    def validations(self) -> dict[str, Validation]:
        """By split, those frames of which everything beside the cloud can be read; clouds are read once at most."""
        found = {}
        for split, ids in self.splits.items():
            parts = {i: self.beside[i].whole for i in ids}
            whole = {i: part for i, part in parts.items() if part is not None}
            found[split] = Validation(
                tuple(whole),
                tuple(labels for labels, _, _ in whole.values()),
                tuple(calibration for _, calibration, _ in whole.values()),
                tuple(size for _, _, size in whole.values()),
                self.kitti,
            )
        return found

    def looked_at(self, split: str) -> list[str]:
        """Frames of a split whose clouds were looked at."""
        return [i for i in self.splits[split] if i in self.clouds]

    def targets(self, split: str, wanted: Wanted) -> int:
        """Objects that a detector learns from, in the frames looked at."""
        of = (self.clouds[i].targets[wanted] for i in self.looked_at(split))
        return int(sum(mask.sum() for mask in of))

    def objects(self, split: str, wanted: Wanted) -> int:
        """Labels of a detector's classes, in the frames looked at."""
        of = (self.beside[i].labels for i in self.looked_at(split))
        return sum(int(np.isin(one.types, wanted.classes).sum()) for one in of if one is not None)


Tick = Callable[[], object]


def gather(
    kitti: KittiFolder,
    splits: Mapping[str, Sequence[str]],
    wanted: tuple[Wanted, ...],
    protocol: Protocol,
    most_clouds: int | None,
    tick: Tick = lambda: None,
) -> Facts:
    """Read labels, calibrations and pictures' sizes of all frames, and the clouds of some.

    Args:
        kitti: the folder.
        splits: ids by name of the split, that which is learnt from first.
        wanted: what detectors learn from.
        protocol: what an AP stands for.
        most_clouds: of each split, evenly chosen; more where no target is among those of the first; None: all.
        tick: called for each frame that was read.
    """
    problems: list[DataError] = []
    beside = {}
    for frame_id in dict.fromkeys(i for ids in splits.values() for i in ids):
        beside[frame_id] = look_beside(kitti, frame_id, wanted, problems)
        tick()
    clouds: dict[str, Cloud] = {}

    def look(frame_id: str) -> Cloud | None:
        if frame_id not in clouds:
            cloud = look_at_cloud(kitti, frame_id, beside[frame_id], wanted, problems)
            tick()
            if cloud is None:
                return None
            clouds[frame_id] = cloud
        return clouds[frame_id]

    for ids in splits.values():
        for frame_id in some_of(ids, most_clouds):
            look(frame_id)
    for one in wanted:
        _look_for_a_target(one, next(iter(splits.values())), beside, clouds, look)
    return Facts(
        kitti=kitti,
        splits={name: tuple(ids) for name, ids in splits.items()},
        beside=beside,
        clouds=clouds,
        wanted=wanted,
        protocol=protocol,
        problems=problems,
    )


def _look_for_a_target(
    wanted: Wanted,
    ids: Sequence[str],
    beside: Mapping[str, Beside],
    clouds: Mapping[str, Cloud],
    look: Callable[[str], Cloud | None],
) -> None:
    """Look at further clouds until one holds a target: a class may be rare, and a few clouds say nothing of it."""
    if any(clouds[i].targets[wanted].any() for i in ids if i in clouds):
        return
    for frame_id in ids:
        labels = beside[frame_id].labels
        if frame_id in clouds or labels is None or not np.isin(labels.types, wanted.classes).any():
            continue
        cloud = look(frame_id)
        if cloud is not None and cloud.targets[wanted].any():
            return


def some_of(ids: Sequence[str], most: int | None) -> list[str]:
    """At most so many, evenly spread; always the same."""
    if most is None or len(ids) <= most:
        return list(ids)
    return [ids[k] for k in np.linspace(0, len(ids) - 1, most).round().astype(int)]


def look_beside(
    kitti: KittiFolder, frame_id: str, wanted: Iterable[Wanted], problems: list[DataError]
) -> Beside:
    """Everything of a frame but its cloud; what cannot be read, or not learnt from, is noted."""
    picture = kitti.path("image_2", frame_id)
    labels = _try(problems, lambda: kitti.read_labels(frame_id))
    if labels is not None:
        types = [name for one in wanted for name in one.classes]
        _try(problems, lambda: check_sizes(labels, types, kitti.path("label_2", frame_id)))
    return Beside(
        labels,
        _try(problems, lambda: kitti.read_calibration(frame_id)),
        _try(problems, lambda: kitti.image_size(frame_id)),
        picture.suffix.lower() if picture.exists() else None,
    )


def look_at_cloud(
    kitti: KittiFolder,
    frame_id: str,
    beside: Beside,
    wanted: Iterable[Wanted],
    problems: list[DataError],
) -> Cloud | None:
    """A frame's cloud and what of it lies on objects; None, and noted, where it cannot be read."""
    read = _try(problems, lambda: kitti.read_cloud(frame_id))
    if read is None:
        return None
    points = read.points_velo
    kept = points
    if kitti.crop == "image":
        if beside.calibration is None or beside.image_size is None:
            return None  # noted already
        kept = points[beside.calibration.in_image(points, beside.image_size)]
    labels = beside.labels if beside.labels is not None else labels_from_columns([], NOTHING, False)
    boxes = np.full((len(labels), 7), np.nan)
    whole = (labels.boxes_cam[:, 3:6] > 0).all(axis=1)
    held, upper = np.zeros((2, len(labels)), dtype=np.int64)
    if beside.calibration is not None and whole.any():
        boxes[whole] = beside.calibration.boxes_to_velo(labels.boxes_cam[whole])
        held[whole] = count_points_inside(kept, boxes[whole])
        halves = beside.calibration.boxes_to_velo(_upper_halves(labels.boxes_cam[whole]))
        upper[whole] = count_points_inside(kept, halves)
    place = points[::EVERY, :3] if len(points) else np.zeros((1, 3), dtype=np.float32)
    center = np.median(place.astype(np.float64), axis=0)
    tones = points[:, 3] if len(points) else np.zeros(1, dtype=np.float32)
    return Cloud(
        points=len(points),
        dropped=read.dropped,
        kept=len(kept),
        in_range={one.detector: int(one.points_in_range(kept).sum()) for one in wanted},
        center=(float(center[0]), float(center[1]), float(center[2])),
        reach=float(np.percentile(np.linalg.norm(place, axis=1), 95)),
        spread=float(np.percentile(np.linalg.norm(place - center, axis=1), 95)),
        reflectance=(float(tones.min()), float(tones.max())),
        held=held,
        upper=upper,
        targets={one: one.targets(labels, boxes, held) for one in wanted},
    )


def _upper_halves(boxes_cam: NDArray[np.float64]) -> NDArray[np.float64]:
    halves = boxes_cam.copy()
    halves[:, 3] /= 2
    halves[:, 1] -= halves[:, 3]  # y points down
    return halves


def _try(problems: list[DataError], read: Callable[[], T]) -> T | None:
    try:
        return read()
    except DataError as error:
        if str(error) not in {str(other) for other in problems[-3:]}:  # one file read twice
            problems.append(error)
        return None
