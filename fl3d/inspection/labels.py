"""What may be odd about labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from fl3d.data.labels import Labels
from fl3d.inspection.facts import Facts
from fl3d.inspection.finding import Finding, warning
from fl3d.inspection.wanted import Wanted

Mask = NDArray[np.bool_]
UNSET = -10.0  # what KITTI writes where there is no angle
NEAR = 30.0  # metres: nearer objects that are not hidden hold points
# Such cars hold 10 points, 5 of them in the upper half: 79 of 80 in KITTI's 32 clouds; 13 where boxes stand half their
# height too high, 23 where clouds are mirrored (42 hold 10 points: of the road). Sparser scanners hit fewer.
FEW_HIT = 0.5
# Metres between which half of a class is long; KITTI's are 2.2 to 6.7, 0.2 to 1.4 and 1.2 to 2.2 long, all of them.
LENGTHS = {"Car": (2.0, 7.0), "Pedestrian": (0.2, 1.5), "Cyclist": (1.0, 2.5)}


def of_labels(facts: Facts) -> Iterator[Finding]:
    """Everything that looks odd in labels of any split."""
    frames = {i: one.labels for i, one in facts.beside.items() if one.labels is not None}
    yield from _values(facts, frames)
    yield from _sizes(facts, frames, sorted({name for one in facts.wanted for name in one.classes}))
    for one in facts.wanted:
        yield from _hits(facts, one)


def _values(facts: Facts, frames: dict[str, Labels]) -> Iterator[Finding]:
    """Angles, occlusions and truncations that KITTI does not have."""
    yield from _each(
        facts,
        frames,
        lambda of: (np.abs(of.boxes_cam[:, 6]) > 2 * np.pi) & (of.boxes_cam[:, 6] != UNSET),
        "objects turned by more than 2 pi",
        "Are the angles in degrees? rotation_y is in radians.",
    )
    yield from _each(
        facts,
        frames,
        lambda of: (of.occluded > 3) | (of.occluded < 0),
        "objects with an occlusion that KITTI does not have (0 to 3)",
        "KITTI's evaluator counts negative ones as visible and ignores those above 2.",
    )
    yield from _each(
        facts,
        frames,
        lambda of: (of.truncated > 1) | (of.truncated < 0),
        "objects with a truncation that KITTI does not have (0 to 1)",
        "KITTI's evaluator counts negative ones as whole and ignores those above 0.5.",
    )


def _each(
    facts: Facts,
    frames: dict[str, Labels],
    is_odd: Callable[[Labels], Mask],
    what: str,
    advice: str,
) -> Iterator[Finding]:
    """A finding of the objects that are odd in the same way, with the first of their files."""
    found = {i: int((is_odd(labels) & real(labels)).sum()) for i, labels in frames.items()}
    total = sum(found.values())
    if total:
        first = next(i for i, n in found.items() if n)
        files = sum(n > 0 for n in found.values())
        yield warning(f"{total} {what}.", advice, facts.kitti.path("label_2", first), files)


def real(labels: Labels) -> Mask:
    """Which rows are objects, not regions to be ignored."""
    return np.asarray(labels.types != "DontCare", dtype=bool)


def _sizes(facts: Facts, frames: dict[str, Labels], wanted: list[str]) -> Iterator[Finding]:
    """Boxes of another size than their class has: other units, or sizes in another order."""
    for name in wanted:
        boxes = [of.boxes_cam[of.types == name] for of in frames.values()]
        sizes = np.concatenate([np.zeros((0, 3)), *(box[:, 3:6] for box in boxes)])
        sizes = sizes[(sizes > 0).all(axis=1)]
        if not len(sizes):
            continue
        h, w, length = np.median(sizes, axis=0)
        low, high = LENGTHS.get(name, (0.0, np.inf))
        told = f"half of the labels of class {name} are {h:.4g} m high, {w:.4g} m wide, {length:.4g} m long or more."
        if not low <= length <= high or (name == "Car" and max(h, w) > length):
            yield warning(
                told, "KITTI's are height, width, length, in metres: are order and unit right?"
            )


def _hits(facts: Facts, wanted: Wanted) -> Iterator[Finding]:
    """Near, visible objects without points: boxes and cloud do not fit."""
    near = hit = 0
    for frame_id, cloud in facts.clouds.items():
        labels = facts.beside[frame_id].labels
        if labels is None:
            continue
        x, z = labels.boxes_cam[:, 0], labels.boxes_cam[:, 2]
        seen = (labels.occluded <= 1) & (labels.truncated < 0.3) & (np.hypot(x, z) < NEAR)
        own = np.isin(labels.types, wanted.classes) & (labels.boxes_cam[:, 3:6] > 0).all(axis=1)
        near += int((seen & own).sum())
        hit += int((seen & own & (cloud.held >= 10) & (cloud.upper >= 5)).sum())
    if near >= 5 and hit < FEW_HIT * near:
        names = " and ".join(wanted.classes)
        yield warning(
            f"only {hit} of {near} labels of class {names} within {NEAR:.0f} m hold 10 points, 5 of them in the upper "
            "half.",
            "Do boxes and clouds fit? x, y, z is the middle of a box's bottom in the camera's frame, y points down; "
            "clouds have x ahead, y left, z up.",
        )
