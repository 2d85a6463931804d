"""What a detector learns from, as its config says it; no network is built."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.config.objects import locate
from fl3d.core.records import Config
from fl3d.data.classes import CARS, class_of
from fl3d.data.labels import Labels

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Wanted:
    """What a detector learns from.

    Args:
        detector: as the papers write it; of several classes ``VoxelNet: Pedestrian``.
        classes: label types that become targets.
        min_points: LiDAR points that an object must hold.
        range_velo: x0, y0, z0, x1, y1, z1 in metres; None: no limits.
        image_boxes: whether it needs what a 2D detector found.
    """

    detector: str
    classes: tuple[str, ...]
    min_points: int
    range_velo: tuple[float, ...] | None
    image_boxes: bool

    def points_in_range(self, points_velo: NDArray[np.float32]) -> Mask:
        """Which points its network sees: (N,)."""
        return self._within(points_velo[:, :3])

    def targets(
        self, labels: Labels, boxes_velo: NDArray[np.float64], held: NDArray[np.int64]
    ) -> Mask:
        """Which objects it learns from: (N,).

        Args:
            labels: of a frame.
            boxes_velo: (N, 7) their boxes; NaN where an object has none.
            held: (N,) LiDAR points on each.
        """
        own = np.isin(labels.types, self.classes) & (held >= self.min_points)
        return own & self._within(boxes_velo[:, :2])

    def _within(self, places: NDArray[np.floating]) -> Mask:
        if self.range_velo is None:
            return np.asarray(np.isfinite(places).all(axis=1))
        n = places.shape[1]
        low, high = np.array(self.range_velo[:3]), np.array(self.range_velo[3:])
        return np.asarray(((places >= low[:n]) & (places < high[:n])).all(axis=1))


def wanted_by(configs: Iterable[Config]) -> tuple[Wanted, ...]:
    """What the detectors of some trials learn from, each once; nothing of those that do not say it."""
    return tuple(dict.fromkeys(one for config in configs for one in _wanted_by(config)))


def _wanted_by(config: Config) -> list[Wanted]:
    detector, asked = config["detector"], config.get("classes", CARS)
    if "_target_" not in detector:
        return []
    kind = locate(detector["_target_"], "detector._target_")
    rule = detector.get("targets") or {}
    types = tuple(rule.get("classes") or (asked if getattr(kind, "LEARNS_FROM", ()) else ()))
    if not types:
        return []
    reach, name = detector.get("range_velo"), getattr(kind, "NAME", kind.__name__)
    own = detector.get("per_class") or {}
    return [
        Wanted(
            detector=name if len(asked) == 1 else f"{name}: {one}",
            classes=tuple(label for label in types if class_of(label, asked) == number),
            min_points=max(1, int(own.get(one, {}).get("min_points", rule.get("min_points", 1)))),
            range_velo=None if reach is None else tuple(float(x) for x in reach),
            image_boxes=bool(getattr(kind, "IMAGE_BOXES", False)),
        )
        for number, one in enumerate(asked)
    ]
