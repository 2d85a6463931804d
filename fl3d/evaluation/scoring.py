"""A checkpoint's detections held against the labels, and its scores."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.data.label_table import LabelTable
from fl3d.evaluation.average_precision import Comparison, Curve, compare, evaluate
from fl3d.evaluation.protocol import Protocol, of_class
from fl3d.evaluation.recall import OVERLAPS, best_overlaps
from fl3d.evaluation.stored import StoredDetections
from fl3d.evaluation.validation import Validation

Float = NDArray[np.float64]


def compare_stored(
    detections: StoredDetections, validation: Validation, protocol: Protocol
) -> Comparison:
    """A checkpoint's detections, as the protocol sees them, held against the labels.

    Args:
        detections: as stored.
        validation: the same frames.
        protocol: what the AP stands for.

    Raises:
        DataError: the frames differ.
    """
    if detections.frame_ids != validation.ids:
        raise DataError("detections are of other frames than the validation split", "detections")
    det = detections.table(validation.calibrations, validation.image_sizes, protocol)
    gt, beyond, points = ground_truths(validation, protocol)
    return compare(gt, det, protocol, beyond, points)


def ground_truths(
    validation: Validation, protocol: Protocol
) -> tuple[LabelTable, NDArray[np.bool_], NDArray[np.int64] | None]:
    """What ``compare`` takes of the validation frames, and ``count_labels(gt, protocol, classes, beyond, points)``.

    Returns:
        the labels, which of them lie outside the protocol's area (G,), and the points on each (G,), which are None
        unless the protocol goes by them.

    Raises:
        DataError: a cloud cannot be read.
    """
    points = validation.points if protocol.difficulty == "points" else None
    return validation.table, validation.beyond(protocol), points


def score(
    detections: StoredDetections, validation: Validation, protocol: Protocol
) -> dict[str, float]:
    """AP of a checkpoint's detections, and recall of all its boxes; arguments and errors as ``compare_stored``.

    Returns:
        ``{"ap_3d/moderate": ..., "ap_3d_r40/moderate": ..., ...}`` for image, bev and 3d in percent; and
        ``{"recall_3d/0.5": ...}``, the share of objects that any stored box of their class overlaps by more, before
        cut and suppression, with ``recall_3d/mean_iou``, their mean best overlap. Of several classes these are the
        means over those that have ground truths there, and each class has its own: ``ap_3d/moderate/Pedestrian``.
    """
    curves = evaluate(compare_stored(detections, validation, protocol), protocol.classes)
    by_class = {}
    for name, own in curves.items():
        best = best_overlaps(_objects_and_boxes(detections, validation, protocol, name))
        by_class[name] = _aps(own) | _recalls(best)
    keys = by_class[protocol.classes[0]]
    scores = {key: _mean([one[key] for one in by_class.values()]) for key in keys}
    for name, own_scores in by_class.items() if len(by_class) > 1 else ():
        scores |= {of_class(key, name): _mean([value]) for key, value in own_scores.items()}
    return scores


def _mean(values: Sequence[float]) -> float:
    """Over the classes that have ground truths; 0 where none has, for stores keep numbers."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else 0.0


def _aps(curves: Mapping[str, Mapping[str, Curve]]) -> dict[str, float]:
    """APs of one class by their names; NaN where no ground truth counts."""
    found = {}
    for metric, levels in curves.items():
        for difficulty, curve in levels.items():
            found[f"ap_{metric}/{difficulty}"] = curve.ap_r11 if curve.n_gt else math.nan
            found[f"ap_{metric}_r40/{difficulty}"] = curve.ap_r40 if curve.n_gt else math.nan
    return found


def _recalls(best: Float) -> dict[str, float]:
    """Recalls of one class by their names, from each object's best overlap; NaN where there is no object."""
    if not len(best):
        return dict.fromkeys(
            [*(f"recall_3d/{t:g}" for t in OVERLAPS), "recall_3d/mean_iou"], math.nan
        )
    found = {f"recall_3d/{t:g}": float((best > t).mean()) for t in OVERLAPS}
    return found | {"recall_3d/mean_iou": float(best.mean())}


def _objects_and_boxes(
    detections: StoredDetections, validation: Validation, protocol: Protocol, name: str
) -> list[tuple[Float, Float]]:
    """Of each frame all objects of a class within the protocol's area, of any difficulty, and all stored boxes."""
    found = []
    beyond = np.split(validation.beyond(protocol), validation.table.offsets[1:-1])
    for index, (labels, calibration) in enumerate(
        zip(validation.labels, validation.calibrations, strict=True)
    ):
        own = (labels.types == name) & ~beyond[index]
        objects = calibration.boxes_to_velo(labels.boxes_cam[own])
        found.append((objects, detections.boxes_of(index, name, calibration)))
    return found
