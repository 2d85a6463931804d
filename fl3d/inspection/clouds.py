"""What may be odd about clouds, and about what a 2D detector found."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from fl3d.inspection.facts import Cloud, Facts
from fl3d.inspection.finding import Finding, warning

FAR = 1000.0  # metres: no scanner reaches so far
MILLIMETRES = (
    5000.0  # of reach: a cloud in millimetres; a map's coordinates lie in one place instead
)
FEW = 500  # points of a whole cloud


def of_clouds(facts: Facts) -> Iterator[Finding]:
    """Everything that looks odd in the clouds that were looked at."""
    rules: tuple[tuple[Callable[[Cloud], bool], Callable[[Cloud], str], str], ...] = (
        (lambda c: c.points == 0, lambda c: "no points.", ""),
        (
            lambda c: 0 < c.points < FEW,
            lambda c: f"only {c.points} points.",
            "",
        ),
        (
            lambda c: c.dropped > 0,
            lambda c: f"{c.dropped} points are not finite and are left out.",
            "",
        ),
        (
            _is_map,
            _where,
            "Coordinates of a map? Subtract the sensor's place from clouds and labels.",
        ),
        (
            _is_millimetres,
            _where,
            "Millimetres, or another unit? Clouds are in metres, and the sensor is their origin.",
        ),
        (
            lambda c: c.points > 0 and c.kept == 0,
            lambda c: f"none of its {c.points} points is in the picture.",
            "See the calibration; data.crop=none keeps all of them.",
        ),
        (
            lambda c: c.points > 0 and c.reflectance[1] > 1.5,
            lambda c: (
                f"reflectances go from {c.reflectance[0]:.3g} to {c.reflectance[1]:.4g}, and networks expect 0 to 1."
            ),
            "For 0 to 255 give data.cloud.reflectance_scale=255; for another range its largest value.",
        ),
        (
            lambda c: c.points > 0 and c.reflectance[0] == c.reflectance[1],
            lambda c: f"every reflectance is {c.reflectance[0]:.3g}.",
            "Detectors can learn nothing from it.",
        ),
    )
    for is_odd, message, advice in rules:
        odd = [frame_id for frame_id, cloud in facts.clouds.items() if is_odd(cloud)]
        if odd:
            first = odd[0]
            path = facts.kitti.path("velodyne", first)
            yield warning(message(facts.clouds[first]), advice, path, len(odd))


def _is_map(cloud: Cloud) -> bool:
    """Far from the origin, and all in one place."""
    away = float(np.linalg.norm(cloud.center))
    return away > FAR and cloud.spread < away / 10


def _is_millimetres(cloud: Cloud) -> bool:
    return cloud.reach > FAR and not _is_map(cloud)


def _where(cloud: Cloud) -> str:
    x, y, z = cloud.center
    return f"its points lie around {x:.6g}, {y:.6g}, {z:.4g} m, and up to {cloud.reach:.4g} m away."


def of_image_boxes(facts: Facts) -> Iterator[Finding]:
    """What a 2D detector found, where a detector needs it."""
    if not any(one.image_boxes for one in facts.wanted):
        return
    boxes = facts.kitti.image_boxes
    folder = facts.kitti.root / "rgb_detections"
    if boxes is None:
        yield warning("no 2D detections, which Frustum ConvNet starts from.", "", folder)
        return
    for split, ids in facts.splits.items():
        n_with = sum(frame_id in boxes for frame_id in ids)
        if n_with < len(ids) / 2:
            example = next(iter(boxes), "none")
            yield warning(
                f"2D detections name {n_with} of the {len(ids)} frames of split {split} (they name {len(boxes)} "
                f"frames, such as '{example}').",
                "A box's picture must be called as its frame.",
                folder,
            )
