"""What an AP stands for: how boxes are cut, matched and averaged, as one record."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, options
from fl3d.core.names import check_name
from fl3d.data.classes import CARS, DONTCARE, NEIGHBOURS, why_no_classes
from fl3d.data.label_parser import kitti_spelling
from fl3d.evaluation import MEANS, VERSION
from fl3d.geometry.nms import KINDS

METRICS = ("image", "bev", "3d")
DIFFICULTIES = ("easy", "moderate", "hard")
VARIANTS = ("A", "B")
GRADINGS = ("image", "distance", "points", "none")
# Where a level ends, unless a protocol says: metres, as far as Waymo's and ONCE's ranges end at 30 and 50 m and KITTI's
# labels and the paper's detection range at 70 m; points on an object, of which Waymo asks more than five for its first
# level and one for its second. Each level holds the one before, as KITTI's do.
LIMITS = {"distance": (30.0, 50.0, 70.0), "points": (30.0, 6.0, 1.0)}
METRIC_NAMES = tuple(
    f"ap_{metric}{average}/{difficulty}"
    for metric in METRICS
    for average in ("", "_r40")
    for difficulty in DIFFICULTIES
)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _are_numbers(values: object, count: int) -> bool:
    is_list = isinstance(values, list | tuple) and len(values) == count
    return is_list and all(_is_number(value) for value in values)  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Protocol:
    """How detections become an AP.

    Args:
        name: for people.
        variant: of the official evaluator: ``A`` ignores ground truths lower than the minimum height (the
            paper's), ``B`` those not higher (its fork, and the Python ports).
        overlaps: minimum overlap per class, for image, bird's-eye view and 3D.
        score_threshold: detections below are dropped. The paper's "threshold 0.8" is this one.
        nms_iou: overlap above which the lower-scored of two detections is dropped.
        nms_kind: ``standup``, ``rotated`` or ``3d``, see ``geometry.nms``.
        max_detections: kept per frame and class.
        image_box: 2D box of a detection that brings none of its own: ``clipped`` to the picture, or ``unclipped``,
            cut to whole pixels, as the paper's code writes it.
        ignore_beyond: x0, y0, x1, y1 in metres, LiDAR frame: ground truths whose centre lies outside are
            neither hits nor misses; None counts all.
        difficulty: what easy, moderate and hard go by. ``image``: KITTI's own, height in the picture, occlusion and
            truncation. The others are fl3d's, need no picture, have no image metric, and count objects all around the
            sensor: ``distance`` from the origin of the labels' coordinates over ground, ``points`` of the LiDAR on an
            object, ``none``: every object at all three levels.
        limits: where easy, moderate and hard end, metres (rising) or points (falling); None: ``LIMITS``.
        neighbours: by class, types of labels that are neither hits nor misses, beside KITTI's (Van for Car,
            Person_sitting for Pedestrian), which a class that is named here has not.
        classes: that a sweep's scores are of, from the key ``classes``; several have scores each and their mean.
    """

    name: str
    variant: str
    overlaps: dict[str, tuple[float, float, float]]
    score_threshold: float
    nms_iou: float
    nms_kind: str
    max_detections: int
    image_box: str = "clipped"
    ignore_beyond: tuple[float, float, float, float] | None = None
    difficulty: str = "image"
    limits: tuple[float, float, float] | None = None
    neighbours: dict[str, list[str]] | None = None
    classes: tuple[str, ...] = CARS

    def __post_init__(self) -> None:
        choices = (
            ("variant", self.variant, VARIANTS),
            ("nms_kind", self.nms_kind, KINDS),
            ("image_box", self.image_box, ("clipped", "unclipped")),
            ("difficulty", self.difficulty, GRADINGS),
        )
        for key, value, possible in choices:
            if value not in possible:
                raise ConfigError(
                    f"protocol.{key}: no choice '{value}'. {options(value, possible)}"
                )
        for name, own in self.overlaps.items():
            if not _are_numbers(own, 3) or not all(0 <= overlap <= 1 for overlap in own):
                raise ConfigError(
                    f"protocol.overlaps.{name}: {own} are not three numbers from 0 to 1, for image, BEV and 3D"
                )
            _check_class("protocol.overlaps", name)
        for key, number in (("score_threshold", self.score_threshold), ("nms_iou", self.nms_iou)):
            if not _is_number(number) or not 0 <= number <= 1:
                raise ConfigError(f"protocol.{key}: '{number}' is not a number from 0 to 1")
        count = self.max_detections
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise ConfigError(
                f"protocol.max_detections: '{self.max_detections}' is not a whole number of at least 1"
            )
        if self.ignore_beyond is not None and not _are_numbers(self.ignore_beyond, 4):
            raise ConfigError(f"protocol.ignore_beyond: {self.ignore_beyond} is not x0, y0, x1, y1")
        self._check_limits()
        self._check_neighbours()
        object.__setattr__(self, "classes", tuple(self.classes))  # as JSON brings it, a list

    def check_classes(self) -> None:
        """Refuse classes that the protocol does not know.

        Raises:
            ConfigError: naming the key to give.
        """
        wrong = why_no_classes(self.classes)
        if wrong:
            raise ConfigError(f"classes: {list(self.classes)} {wrong}")
        for name in self.classes:
            if name not in self.overlaps:
                raise ConfigError(
                    f"classes: protocol {self.name} has no overlaps of {name}, only of {', '.join(self.overlaps)}; "
                    f"give +protocol.overlaps.{name}=[0.7,0.5,0.5], for image, BEV and 3D"
                )

    def _check_neighbours(self) -> None:
        for name, types in (self.neighbours or {}).items():
            key = f"protocol.neighbours.{name}"
            if not isinstance(types, list | tuple):
                raise ConfigError(f"{key}: '{types}' is no list of types of labels, such as [Van]")
            for one in types:
                _check_class(key, str(one))

    def neighbours_of(self, name: str) -> tuple[str, ...]:
        """Types of labels that are neither hits nor misses of a class."""
        given = self.neighbours or {}
        spelled = kitti_spelling(name)
        return tuple(given.get(name, given.get(spelled, NEIGHBOURS.get(spelled, ()))))

    def _check_limits(self) -> None:
        if self.limits is None:
            return
        if self.difficulty not in LIMITS:
            raise ConfigError(
                f"protocol.limits: {self.limits}, but difficulty {self.difficulty} has none; only "
                f"{' and '.join(LIMITS)} have"
            )
        rising = self.difficulty == "distance"
        given = list(self.limits) if isinstance(self.limits, list | tuple) else [self.limits]
        numbers = [x for x in given if isinstance(x, int | float) and x > 0]
        if len(given) != 3 or len(numbers) != 3 or numbers != sorted(numbers, reverse=not rising):
            raise ConfigError(
                f"protocol.limits: {given} are not three {'rising' if rising else 'falling'} numbers "
                f"above 0, such as {list(LIMITS[self.difficulty])}"
            )

    @property
    def uses_picture(self) -> bool:
        """Whether only what the camera sees counts, by its size in the picture."""
        return self.difficulty == "image"

    @property
    def metrics(self) -> tuple[str, ...]:
        """Those of ``METRICS`` that it has."""
        return METRICS if self.uses_picture else METRICS[1:]

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Those of ``METRIC_NAMES`` that it has; of several classes their means, then those of each class."""
        own = tuple(
            name for name in METRIC_NAMES if self.uses_picture or not name.startswith("ap_image")
        )
        if len(self.classes) == 1:
            return own
        return own + tuple(of_class(metric, name) for name in self.classes for metric in own)

    @property
    def level_limits(self) -> tuple[float, float, float] | None:
        """Where its levels end; None where they do not go by distance or points."""
        return self.limits if self.limits is not None else LIMITS.get(self.difficulty)

    @property
    def levels_text(self) -> str:
        """What easy, moderate and hard go by, for people: ``up to 30, 50, 70 m away``."""
        if self.uses_picture:
            return "KITTI's height, occlusion and truncation"
        limits = self.level_limits
        if limits is None:
            return "every object"
        numbers = ", ".join(f"{limit:g}" for limit in limits)
        return (
            f"up to {numbers} m away"
            if self.difficulty == "distance"
            else f"at least {numbers} points"
        )

    @property
    def id(self) -> str:
        """Identity of the scores it gives: name and hash of every value and of the evaluator's version.

        What came later than the first protocols enters only where it is not its default, so that theirs stay.
        """
        version = [VERSION] if len(self.classes) == 1 else [VERSION, MEANS]
        return f"{self.name}-{digest([*version, self._values()])[:8]}"

    def _values(self) -> dict[str, Any]:
        values = asdict(self)
        usual = {"classes": CARS, "neighbours": None}
        values = {
            key: value for key, value in values.items() if key not in usual or value != usual[key]
        }
        if self.difficulty == "image":
            return {key: values[key] for key in values if key not in ("difficulty", "limits")}
        return {**values, "limits": self.level_limits}


def of_class(metric: str, name: str) -> str:
    """Name of a metric of one of several classes: ``ap_3d/moderate/Pedestrian``."""
    return f"{metric}/{name}"


def split_metric(metric: str) -> tuple[str, str | None]:
    """A metric without its class, and the class: ``3d/moderate``, ``Pedestrian``; None: the one class, or the mean."""
    plain, name = metric.split("/")[:2], metric.split("/")[2:]
    return "/".join(plain), "/".join(name) or None


def _check_class(key: str, name: str) -> None:
    """Refuse what cannot be the name of a class."""
    check_name(key, name)
    if kitti_spelling(name) == DONTCARE:
        raise ConfigError(f"{key}: {DONTCARE} is no class: such regions are left out")
