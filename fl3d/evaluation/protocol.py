"""What an AP stands for: how boxes are cut, matched and averaged, as one record."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, options
from fl3d.evaluation import VERSION
from fl3d.geometry.nms import KINDS

METRICS = ("image", "bev", "3d")
DIFFICULTIES = ("easy", "moderate", "hard")
VARIANTS = ("A", "B")
METRIC_NAMES = tuple(
    f"ap_{metric}{average}/{difficulty}"
    for metric in METRICS
    for average in ("", "_r40")
    for difficulty in DIFFICULTIES
)


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
        max_detections: kept per frame.
        image_box: 2D box of a detection that brings none of its own: ``clipped`` to the picture, or ``unclipped``,
            cut to whole pixels, as the paper's code writes it.
        ignore_beyond: x0, y0, x1, y1 in metres, LiDAR frame: ground truths whose centre lies outside are
            neither hits nor misses; None counts all.
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

    def __post_init__(self) -> None:
        choices = (
            ("variant", self.variant, VARIANTS),
            ("nms_kind", self.nms_kind, KINDS),
            ("image_box", self.image_box, ("clipped", "unclipped")),
        )
        for key, value, possible in choices:
            if value not in possible:
                raise ConfigError(
                    f"protocol.{key}: no choice '{value}'. {options(value, possible)}"
                )
        for key, number in (("score_threshold", self.score_threshold), ("nms_iou", self.nms_iou)):
            if not isinstance(number, int | float) or not 0 <= number <= 1:
                raise ConfigError(f"protocol.{key}: '{number}' is not a number from 0 to 1")
        if not isinstance(self.max_detections, int) or self.max_detections < 1:
            raise ConfigError(
                f"protocol.max_detections: '{self.max_detections}' is not a whole number of at least 1"
            )
        if self.ignore_beyond is not None and len(self.ignore_beyond) != 4:
            raise ConfigError(f"protocol.ignore_beyond: {self.ignore_beyond} is not x0, y0, x1, y1")

    @property
    def id(self) -> str:
        """Identity of the scores it gives: name and hash of every value and of the evaluator's version."""
        return f"{self.name}-{digest([VERSION, asdict(self)])[:8]}"
