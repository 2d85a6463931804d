"""KITTI average precision of a set of frames, in image, bird's-eye view and 3D.

The rules are those of KITTI's official offline evaluator, in its two common variants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.data.labels import Labels
from fl3d.errors import ConfigError
from fl3d.evaluation.matching import count, matched_scores, recall_thresholds
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol
from fl3d.geometry.iou import bev_and_3d_iou_cam, image_iou

MIN_HEIGHT = (40, 25, 25)  # pixels; easy, moderate, hard
MAX_OCCLUSION = (0, 1, 2)
MAX_TRUNCATION = (0.15, 0.30, 0.50)
NEIGHBOURS = {"car": "van", "pedestrian": "person_sitting"}  # matched, never counted
N_SAMPLES = 41


@dataclass(frozen=True)
class Curve:
    """One class, metric and difficulty.

    Args:
        n_gt: ground truths that count.
        thresholds: (T,) scores, falling.
        tp: (T,) true positives at each.
        fp: (T,) false positives at each.
        precision: (41,) at recall 0, 1/40, ..., 1, made monotone from the right; 0 where never reached.
    """

    n_gt: int
    thresholds: NDArray[np.float64]
    tp: NDArray[np.int64]
    fp: NDArray[np.int64]
    precision: NDArray[np.float64]

    @property
    def ap_r11(self) -> float:
        """AP over 11 recall samples (0, 0.1, ..., 1), in percent."""
        return float(self.precision[::4].sum() / 11 * 100)

    @property
    def ap_r40(self) -> float:
        """AP over 40 recall samples (1/40, ..., 1), in percent."""
        return float(self.precision[1:].sum() / 40 * 100)


@dataclass(frozen=True)
class _FrameMatch:
    """Overlaps of one frame, computed once for all classes, metrics and difficulties."""

    gt: Labels
    det: Labels
    beyond: NDArray[np.bool_]
    overlaps: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
    dontcare: NDArray[np.float64]


def evaluate(
    ground_truths: Sequence[Labels],
    detections: Sequence[Labels],
    protocol: Protocol,
    beyond: Sequence[NDArray[np.bool_]] | None = None,
    classes: Mapping[str, Sequence[float]] | None = None,
) -> dict[str, dict[str, dict[str, Curve]]]:
    """Precision-recall curves of frames.

    Args:
        ground_truths: labels of each frame.
        detections: scored labels of the same frames, already cut and suppressed.
        protocol: classes, overlaps and variant.
        beyond: for each frame, which ground truths are to be ignored whatever their class; None: none.
        classes: minimum overlaps of the classes to look at; None: all of the protocol.

    Returns:
        ``curves[class][metric][difficulty]``.

    Raises:
        ConfigError: both sequences differ in length, or detections carry no scores.
    """
    if len(ground_truths) != len(detections):
        raise ConfigError(f"{len(ground_truths)} frames of labels but {len(detections)} of detections")
    if beyond is None:
        beyond = [np.zeros(len(gt), dtype=bool) for gt in ground_truths]
    frames = [_match(*frame) for frame in zip(ground_truths, detections, beyond, strict=True)]
    return {
        name: {
            metric: {
                difficulty: _curve(frames, name.lower(), m, level, minimum[m], protocol.variant)
                for level, difficulty in enumerate(DIFFICULTIES)
            }
            for m, metric in enumerate(METRICS)
        }
        for name, minimum in (protocol.overlaps if classes is None else classes).items()
    }


def _match(gt: Labels, det: Labels, beyond: NDArray[np.bool_]) -> _FrameMatch:
    if det.scores is None:
        raise ConfigError("detections without scores cannot be evaluated")
    regions = np.char.lower(gt.types) == "dontcare" if len(gt) else np.zeros(0, dtype=bool)
    bev, volume = bev_and_3d_iou_cam(det.boxes_cam, gt.boxes_cam)
    overlaps = (image_iou(det.boxes_image, gt.boxes_image), bev, volume)
    dontcare = image_iou(det.boxes_image, gt.boxes_image[regions], over_a=True)
    return _FrameMatch(gt, det, beyond, overlaps, np.ascontiguousarray(dontcare))


def _curve(frames: list[_FrameMatch], name: str, metric: int, level: int, minimum: float, variant: str) -> Curve:
    prepared = []
    for frame in frames:
        gt_flags, det_flags = ground_truth_flags(frame, name, level, variant), detection_flags(frame.det, name, level)
        # DontCare has no 3D box, so it excuses false alarms in the image alone.
        regions = frame.dontcare if metric == 0 else frame.dontcare[:, :0]
        prepared.append((frame.overlaps[metric], regions, frame.det.scores, gt_flags, det_flags))
    n_gt = sum(int((flags == 0).sum()) for *_, flags, _ in prepared)
    hits = [matched_scores(o, s, g, d, minimum) for o, _, s, g, d in prepared]
    scores = np.sort(np.concatenate([*hits, np.zeros(0)]))[::-1]
    thresholds = recall_thresholds(np.ascontiguousarray(scores), n_gt) if n_gt else np.zeros(0)
    counts = np.zeros((len(thresholds), 2), dtype=np.int64)
    for t, threshold in enumerate(thresholds):
        for frame_arrays in prepared:
            counts[t] += count(*frame_arrays, minimum, threshold)
    tp, fp = counts[:, 0], counts[:, 1]
    precision = np.zeros(N_SAMPLES)
    found = np.divide(tp, tp + fp, out=np.zeros(len(tp)), where=tp + fp > 0)
    precision[: len(found)] = np.maximum.accumulate(found[::-1])[::-1]
    return Curve(n_gt, thresholds, tp, fp, precision)


def ground_truth_flags(frame: _FrameMatch, name: str, level: int, variant: str) -> NDArray[np.int8]:
    """0 counts, 1 ignored, -1 not there: (G,) for a class and difficulty."""
    gt = frame.gt
    types = np.char.lower(gt.types) if len(gt) else gt.types
    height = gt.boxes_image[:, 3] - gt.boxes_image[:, 1]
    low = height < MIN_HEIGHT[level] if variant == "A" else height <= MIN_HEIGHT[level]
    hard = (gt.occluded > MAX_OCCLUSION[level]) | (gt.truncated > MAX_TRUNCATION[level]) | low | frame.beyond
    flags = np.full(len(gt), -1, dtype=np.int8)
    flags[types == name] = 0
    flags[(types == name) & hard] = 1
    flags[types == NEIGHBOURS.get(name, "")] = 1
    return flags


def detection_flags(det: Labels, name: str, level: int) -> NDArray[np.int8]:
    """0 counts, 1 ignored, -1 not there: (D,). Height is looked at before class, in whole pixels."""
    types = np.char.lower(det.types) if len(det) else det.types
    height = np.abs(det.boxes_image[:, 1] - det.boxes_image[:, 3]).astype(np.int64)
    return np.where(height < MIN_HEIGHT[level], 1, np.where(types == name, 0, -1)).astype(np.int8)
