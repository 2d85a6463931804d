"""Mistakes of converters in result files, each of which gives an AP near 0 and no error. Pure.

A mistake is told by boxes that it leaves alone: of what is wrong in space the results are paired with their labels in
the picture, of what is wrong in the picture from above. It is told only where another reading of the same numbers fits
the labels several times better, which no error of a detector brings about.

The limits stand between what honest results have and what mistakes make of them. Honest ones, here and below: on
KITTI's validation split Point-GNN (Car), M3D-RPN (one camera; Car, Pedestrian, Cyclist), a detector in the picture, and
the labels themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.mistaken_boxes import in_picture, in_space, of_medians
from fl3d.evaluation.pairs import near, overlapping, owners_of
from fl3d.evaluation.protocol import METRICS

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
IMAGE, BEV = METRICS.index("image"), METRICS.index("bev")
SAME_IN_PICTURE = 0.7  # overlap that KITTI asks of a car
SAME_FROM_ABOVE = 0.5  # that it asks of people
NEAR = 1.0  # metres over ground: where there are no 2D boxes, or wrong ones
FEWEST = 10  # pairs whose medians say something
# How often a result that hits has a higher score than one that misses. Honest ones: 0.84 to 0.92, so 0.08 to 0.16 when
# they are negated; 0.53 at least of 52 checkpoints of this package's detectors, from their first steps on. Of 30 hits
# and 30 misses with scores by chance it is below 0.3 once in 250 times (0.5 +- 0.075).
LOWEST_ORDER = 0.3
FEWEST_SCORED = 30
# Of a class's results: no honest one is reversed; of boxes x y w h in KITTI's pictures most are.
MOST_REVERSED = 0.05


@dataclass(frozen=True)
class Mistake:
    """Something that a converter may have done to the results of a class.

    Args:
        kind: ``sizes``, ``places``, ``heights``, ``headings``, ``units``, ``picture`` or ``scores``.
        class_name: of the results.
        text: a sentence with numbers, and what KITTI has.
    """

    kind: str
    class_name: str
    text: str


def find_mistakes(held: Comparison) -> tuple[Mistake, ...]:
    """What looks like a converter's mistake, class by class; nothing of an honest detector."""
    return tuple(
        Mistake(kind, name, text)
        for name in held.protocol.overlaps
        if held.det.of(name).any() and held.gt.of(name).any()
        for kind, text in _of_class(held, name)
    )


def _of_class(held: Comparison, name: str) -> Iterator[tuple[str, str]]:
    yield from _space(held, name)
    if held.protocol.uses_picture:
        yield from _picture(held, name)
    yield from _scores(held, name)


def _space(held: Comparison, name: str) -> Iterator[tuple[str, str]]:
    """3D boxes against those of the labels of the same 2D box; without such, of those that stand near."""
    labels, results = held.gt.boxes_cam, held.det.boxes_cam
    has_label, has_result = _have_size(labels), _have_size(results)
    for pairs in (overlapping(held, name, "image", SAME_IN_PICTURE), near(held, name, NEAR)):
        own = pairs.select(has_label[pairs.gt] & has_result[pairs.det])
        if len(own) >= FEWEST:
            yield from in_space(name, labels[own.gt], results[own.det])
            return
    alone = labels[has_label & held.gt.of(name)], results[has_result & held.det.of(name)]
    if min(map(len, alone)) >= FEWEST:
        yield from of_medians(name, *alone)


def _have_size(boxes: Float) -> Mask:
    return np.asarray((boxes[:, 3:6] > 0).all(axis=1))


def _picture(held: Comparison, name: str) -> Iterator[tuple[str, str]]:
    """2D boxes against those of the labels of the same box from above."""
    labels, results = held.gt.boxes_image, held.det.boxes_image
    pairs = overlapping(held, name, "bev", SAME_FROM_ABOVE)
    has_box: Mask = np.all(labels[:, 2:] > labels[:, :2], axis=1)
    is_given: Mask = np.all(results[:, 2:] != results[:, :2], axis=1)
    own = pairs.select(has_box[pairs.gt] & is_given[pairs.det])
    if len(own) >= FEWEST:
        told = list(in_picture(name, labels[own.gt], results[own.det]))
        if told:
            yield from told
            return
    boxes = results[held.det.of(name)]
    reversed_ = (boxes[:, 2:] < boxes[:, :2]).any(axis=1)
    if reversed_.sum() > MOST_REVERSED * len(boxes):
        yield (
            "picture",
            f"{int(reversed_.sum())} of {len(boxes)} results of {name} have x2 < x1 or y2 < y1; KITTI's 2D box is "
            "x1 y1 x2 y2",
        )


def _scores(held: Comparison, name: str) -> Iterator[tuple[str, str]]:
    """Scores of results that hit against those that miss; what hits a neighbour or a DontCare region is neither."""
    shared = np.maximum(held.overlaps.values[IMAGE], held.overlaps.values[BEV])
    is_same = shared >= SAME_FROM_ABOVE
    rows, det = owners_of(held), held.overlaps.detection
    own = held.det.of(name)
    hits, touched = np.zeros(len(own), dtype=bool), np.zeros(len(own), dtype=bool)
    hits[det[is_same & held.gt.of(name)[rows]]] = True
    touched[det[is_same]] = True
    excused = held.overlaps.dontcare > SAME_FROM_ABOVE
    hit, missed = held.det.scores[own & hits], held.det.scores[own & ~touched & ~excused]
    if min(len(hit), len(missed)) < FEWEST_SCORED:
        return
    order = _order(hit, missed)
    if order < LOWEST_ORDER:
        yield (
            "scores",
            f"scores of {name} seem to be the wrong way round: those of {len(hit)} results that hit have a median of "
            f"{np.median(hit):.4g}, those of {len(missed)} that miss {np.median(missed):.4g} (in {order:.0%} of pairs "
            "the hit has the higher one); the surest has KITTI's highest score",
        )


def _order(hit: Float, missed: Float) -> float:
    """Share of pairs of which the hit has the higher score, equal ones half: the area under the ROC curve."""
    low = np.sort(missed)
    below = np.searchsorted(low, hit, "left") + np.searchsorted(low, hit, "right")
    return float(below.mean() / 2 / len(missed))
