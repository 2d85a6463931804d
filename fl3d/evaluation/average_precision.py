"""KITTI average precision of a set of frames, in image, bird's-eye view and 3D.

The rules are those of KITTI's official offline evaluator, in its two common variants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, options
from fl3d.data.label_table import LabelTable
from fl3d.evaluation.levels import (
    Reason,
    detection_flags,
    ground_truth_flags,
    ignored_at,
    is_far,
    reasons,
)
from fl3d.evaluation.matching import Flags, Matches, match_frames, recall_thresholds, sort_matches
from fl3d.evaluation.overlaps import Overlaps, find_overlaps
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol

N_SAMPLES = 41
NO_ANGLE = -10.0  # one detection with this observation angle switches orientation off for all


@dataclass(frozen=True)
class Curve:
    """One class, metric and difficulty.

    Args:
        n_gt: ground truths that count.
        thresholds: (T,) scores, falling.
        tp: (T,) true positives at each.
        fp: (T,) false positives at each.
        precision: (41,) at recall 0, 1/40, ..., 1, made monotone from the right; 0 where never reached.
        orientation: (41,) the same of precision weighed by orientation similarity; None where it is switched off,
            and for bird's-eye view and 3D.
    """

    n_gt: int
    thresholds: NDArray[np.float64]
    tp: NDArray[np.int64]
    fp: NDArray[np.int64]
    precision: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None

    @property
    def ap_r11(self) -> float:
        """AP over 11 recall samples (0, 0.1, ..., 1), in percent."""
        return average_r11(self.precision)

    @property
    def ap_r40(self) -> float:
        """AP over 40 recall samples (1/40, ..., 1), in percent."""
        return average_r40(self.precision)


def average_r11(precision: NDArray[np.float64]) -> float:
    """Mean of samples 0, 4, ..., 40 of (41,), in percent."""
    return float(precision[::4].sum() / 11 * 100)


def average_r40(precision: NDArray[np.float64]) -> float:
    """Mean of samples 1, ..., 40 of (41,), in percent."""
    return float(precision[1:].sum() / 40 * 100)


def most_possible(n_gt: int) -> tuple[float, float]:
    """R11 and R40 of a detector that finds all of so many ground truths and nothing else, in percent.

    Each recall sample needs a hit of its own, so fewer ground truths than samples cannot reach 100.
    """
    once = np.ones(n_gt, dtype=np.int64)
    reached = recall_thresholds(np.zeros(n_gt), once, n_gt) if n_gt else np.zeros(0)
    precision = np.zeros(N_SAMPLES)
    precision[: len(reached)] = 1
    return average_r11(precision), average_r40(precision)


Curves = dict[str, dict[str, dict[str, Curve]]]


@dataclass(frozen=True)
class Comparison:
    """Detections held against ground truths: overlaps are computed once, matches when asked for.

    Args:
        gt: ground truths.
        det: detections of the same frames, with scores.
        protocol: overlaps and variant.
        beyond: (G,) ground truths to be ignored whatever their class.
        overlaps: of all pairs.
        points: (G,) points of the LiDAR on each ground truth, where the protocol goes by them.
    """

    gt: LabelTable
    det: LabelTable
    protocol: Protocol
    beyond: NDArray[np.bool_]
    overlaps: Overlaps
    points: NDArray[np.int64] | None = None

    def matches(self, name: str, metric: str, difficulty: str) -> Matches:
        """Matches of one class, metric and difficulty.

        Args:
            name: of the class, one of the protocol's.
            metric: ``image``, ``bev`` or ``3d``.
            difficulty: ``easy``, ``moderate`` or ``hard``.
        """
        if name not in self.protocol.overlaps:
            raise ConfigError(
                f"protocol.overlaps: no class '{name}'. {options(name, self.protocol.overlaps)}"
            )
        if metric not in self.protocol.metrics:
            raise ConfigError(
                f"protocol {self.protocol.name} has no metric '{metric}'. "
                f"{options(metric, self.protocol.metrics)}"
            )
        m = METRICS.index(metric)
        of_gt, of_det, excused = self.flags(name, metric, difficulty)
        found = match_frames(
            self.gt.offsets,
            self.det.offsets,
            self.overlaps.offsets,
            self.overlaps.detection,
            self.overlaps.values[m],
            of_gt,
            of_det,
            np.ascontiguousarray(self.det.scores),
            excused,
            np.ascontiguousarray(self.gt.values[:, 2]),
            np.ascontiguousarray(self.det.values[:, 2]),
            self.protocol.overlaps[name][m],
        )
        return sort_matches(*found)

    def flags(
        self, name: str, metric: str, difficulty: str
    ) -> tuple[Flags, Flags, NDArray[np.bool_]]:
        """What counts of one class, metric and difficulty.

        Returns:
            of ground truths (G,) and of detections (D,) 0 counts, 1 is ignored, -1 is not there; and which detections
            are no false alarms although they hit nothing (D,).
        """
        m, level = METRICS.index(metric), DIFFICULTIES.index(difficulty)
        why = reasons(self.gt, level, self.protocol, self.beyond, self.points)
        # DontCare has no 3D box, so it excuses false alarms in the image alone.
        excused = (
            self.overlaps.dontcare > self.protocol.overlaps[name][m]
            if metric == "image"
            else is_far(self.det, level, self.protocol)
        )
        return (
            ground_truth_flags(
                self.gt,
                name,
                self.protocol.neighbours_of(name),
                ignored_at(why, len(self.gt.types)),
            ),
            detection_flags(self.det, name, level, self.protocol),
            excused,
        )

    def curve(self, name: str, metric: str, difficulty: str) -> Curve:
        """Precision and recall of one class, metric and difficulty."""
        with_angle = metric == "image" and not (self.det.values[:, 2] == NO_ANGLE).any()
        return curve_of(self.matches(name, metric, difficulty), with_angle)


def compare(
    gt: LabelTable,
    det: LabelTable,
    protocol: Protocol,
    beyond: NDArray[np.bool_] | None = None,
    points: NDArray[np.int64] | None = None,
) -> Comparison:
    """Hold detections against ground truths.

    Args:
        gt: ground truths of F frames.
        det: detections of the same frames, already cut and suppressed.
        protocol: overlaps and variant.
        beyond: (G,) ground truths to be ignored whatever their class; None: none.
        points: (G,) points of the LiDAR on each, where the protocol goes by them.

    Raises:
        ConfigError: the numbers of frames differ.
    """
    if len(gt) != len(det):
        raise ConfigError(f"{len(gt)} frames of labels but {len(det)} of detections")
    ignored = np.zeros(len(gt.types), dtype=bool) if beyond is None else beyond
    return Comparison(gt, det, protocol, ignored, find_overlaps(gt, det), points)


def evaluate(comparison: Comparison, classes: Sequence[str] | None = None) -> Curves:
    """All curves of a comparison, of the protocol's metrics: ``curves[class][metric][difficulty]``.

    Args:
        comparison: see ``compare``.
        classes: which of the protocol's; None: all.
    """
    return {
        name: {
            metric: {level: comparison.curve(name, metric, level) for level in DIFFICULTIES}
            for metric in comparison.protocol.metrics
        }
        for name in (comparison.protocol.overlaps if classes is None else classes)
    }


def curve_of(matches: Matches, with_angle: bool = False) -> Curve:
    """The curve that matches give."""
    n_gt = int(matches.n_gt.sum())
    once = np.ones(len(matches.hit_scores), dtype=np.int64)
    thresholds = (
        recall_thresholds(matches.hit_scores, once, n_gt) if n_gt and len(once) else np.zeros(0)
    )
    last = np.searchsorted(
        -matches.scores, -thresholds, side="right"
    )  # events at or above each threshold
    tp, fp, similar = (
        np.concatenate([[0], np.cumsum(values)])[last]
        for values in (matches.tp, matches.fp, matches.similarity)
    )
    orientation = _samples(similar, tp + fp) if with_angle else None
    return Curve(n_gt, thresholds, tp, fp, _samples(tp, tp + fp), orientation)


def _samples(part: NDArray[np.generic], whole: NDArray[np.int64]) -> NDArray[np.float64]:
    """Ratios at the thresholds, made monotone from the right and filled up with 0: (T,) -> (41,)."""
    ratio = np.divide(part, whole, out=np.zeros(len(whole)), where=whole > 0)
    samples = np.zeros(N_SAMPLES)
    samples[: len(ratio)] = np.maximum.accumulate(ratio[::-1])[::-1]
    return samples


def as_json(
    curves: Curves, ignored: Mapping[str, Mapping[str, Mapping[Reason, int]]] | None = None
) -> dict[str, Mapping[str, object]]:
    """Curves as plain values: thresholds, counts, 41 precisions and both APs, in full doubles.

    Args:
        curves: see ``evaluate``.
        ignored: see ``counts.LabelCounts``: by class and difficulty how many labels do not count, by reason.
    """
    why = ignored or {}
    return {
        name: {
            metric: {
                level: _plain(curve) | _plain_reasons(why.get(name, {}).get(level))
                for level, curve in levels.items()
            }
            for metric, levels in metrics.items()
        }
        for name, metrics in curves.items()
    }


def _plain_reasons(found: Mapping[Reason, int] | None) -> dict[str, object]:
    if found is None:
        return {}
    return {"ignored": {reason.name.lower(): n for reason, n in found.items()}}


def _plain(curve: Curve) -> dict[str, object]:
    plain: dict[str, object] = {
        "n_gt": curve.n_gt,
        "thresholds": curve.thresholds.tolist(),
        "tp": curve.tp.tolist(),
        "fp": curve.fp.tolist(),
        "precision": curve.precision.tolist(),
        "ap_r11": curve.ap_r11,
        "ap_r40": curve.ap_r40,
    }
    if curve.orientation is not None:
        plain["aos_r11"], plain["aos_r40"] = (
            average_r11(curve.orientation),
            average_r40(curve.orientation),
        )
    return plain
