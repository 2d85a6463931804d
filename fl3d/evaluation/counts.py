"""How many labels and results an evaluation counts, and why it does not count the others.

>>> counts = count_labels(table, protocol)          # of labels alone, such as before training
>>> counts.counted["Car"]["moderate"], counts.ignored["Car"]["moderate"]
(2906, {Reason.OCCLUDED: 1500, ...})
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.data.classes import DONTCARE
from fl3d.data.label_parser import kitti_spelling
from fl3d.data.label_table import OTHER, LabelTable, table_from_labels
from fl3d.data.labels import TYPES, Labels
from fl3d.evaluation.levels import Mask, Reason, reasons, result_reasons
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol

TURN = 2 * np.pi
UNSET_ANGLE = -10.0  # what KITTI writes where there is no angle


@dataclass(frozen=True)
class LabelCounts:
    """What labels an evaluation counts.

    Args:
        n_frames: of the labels.
        n_labels: of all classes.
        labels: by class that counts, such as ``{"Car": 120}``, whatever their difficulty.
        counted: of them by class and difficulty, ground truths that count (``n_gt``).
        ignored: of them by class and difficulty, how many do not count for which reason; only what is not 0.
        neighbours: by class, labels of its neighbours by their names (Van for Car), which are neither hits nor misses.
        others: labels of every other class, by its name as it is written, most first.
        dontcare: regions to be ignored.
        without_size: by class, its labels, where none of them has a 3D box.
        turned: labels of the classes that count whose rotation_y is beyond 2 pi.
    """

    n_frames: int
    n_labels: int
    labels: dict[str, int]
    counted: dict[str, dict[str, int]]
    ignored: dict[str, dict[str, dict[Reason, int]]]
    neighbours: dict[str, dict[str, int]]
    others: dict[str, int]
    dontcare: int
    without_size: dict[str, int]
    turned: int

    @property
    def is_empty(self) -> bool:
        """Whether nothing counts, of whatever class and difficulty, so that no AP can be told."""
        return not any(n for levels in self.counted.values() for n in levels.values())


@dataclass(frozen=True)
class ResultCounts:
    """What results an evaluation counts.

    Args:
        n_results: of all classes.
        results: by class that counts.
        ignored: by class that counts and difficulty, how many are neither hits nor false alarms unless they hit, for
            which reason: too low in the picture, or beyond a level that goes by distance; only what is not 0.
        without_box: results of the classes that count without a 2D box.
        without_size: by class, its results, where none of them has a 3D box.
        others: results of every other class, by its name as it is written, most first.
        equal: by class, the score of its results where all of them, two or more, have the same.
        turned: results of the classes that count whose rotation_y is beyond 2 pi.
    """

    n_results: int
    results: dict[str, int]
    ignored: dict[str, dict[str, dict[Reason, int]]]
    without_box: int
    without_size: dict[str, int]
    others: dict[str, int]
    equal: dict[str, float]
    turned: int


def count_labels(
    labels: LabelTable | Sequence[Labels],
    protocol: Protocol,
    classes: Sequence[str] | None = None,
    beyond: Mask | None = None,
    points: NDArray[np.int64] | None = None,
) -> LabelCounts:
    """How many labels count per class and difficulty, and why the others do not; no detections are needed.

    An object that does not count at a level is counted there once, with the first ``Reason`` that holds for it.

    Args:
        labels: a table, or the labels of each frame.
        protocol: what counts, and what difficulty goes by.
        classes: which of the protocol's; None: all.
        beyond: (N,) which labels lie outside the protocol's area, see ``detections.ground_truths``; None: none.
        points: (N,) points of the LiDAR on each; needed where the protocol's difficulty goes by points.

    Raises:
        ConfigError: points are needed, and there are none.
    """
    gt = labels if isinstance(labels, LabelTable) else table_from_labels(labels)
    names = list(protocol.overlaps if classes is None else classes)
    own = {name: gt.of(name) for name in names}
    why = [reasons(gt, level, protocol, beyond, points) for level in range(len(DIFFICULTIES))]
    ignored = {
        name: {level: _first(mask, of) for level, of in zip(DIFFICULTIES, why, strict=True)}
        for name, mask in own.items()
    }
    total = {name: int(mask.sum()) for name, mask in own.items()}
    neighbours = {name: protocol.neighbours_of(name) for name in names}
    by_name = _by_name(gt)
    known = {*map(kitti_spelling, names), DONTCARE}
    known |= {kitti_spelling(other) for of in neighbours.values() for other in of}
    return LabelCounts(
        n_frames=len(gt),
        n_labels=len(gt.types),
        labels=total,
        counted={
            name: {level: total[name] - sum(of.values()) for level, of in levels.items()}
            for name, levels in ignored.items()
        },
        ignored=ignored,
        neighbours={
            name: {other: int(gt.of(other).sum()) for other in of}
            for name, of in neighbours.items()
            if of
        },
        others={name: n for name, n in by_name.items() if name not in known},
        dontcare=int(gt.of(DONTCARE).sum()),
        without_size=_without_size(gt, own),
        turned=_turned(gt, _any(own, len(gt.types))),
    )


def count_results(det: LabelTable, protocol: Protocol) -> ResultCounts:
    """How many results count per class, and why the others do not.

    Args:
        det: results with scores.
        protocol: what counts.
    """
    own = {name: det.of(name) for name in protocol.overlaps}
    any_own = _any(own, len(det.types))
    why = [result_reasons(det, level, protocol) for level in range(len(DIFFICULTIES))]
    known = set(map(kitti_spelling, protocol.overlaps))
    return ResultCounts(
        n_results=len(det.types),
        results={name: int(mask.sum()) for name, mask in own.items()},
        ignored={
            name: {level: _first(mask, of) for level, of in zip(DIFFICULTIES, why, strict=True)}
            for name, mask in own.items()
        },
        without_box=int((any_own & (det.values[:, 6] == det.values[:, 4])).sum()),
        without_size=_without_size(det, own),
        others={name: n for name, n in _by_name(det).items() if name not in known},
        equal={
            name: float(det.scores[mask][0])
            for name, mask in own.items()
            if mask.sum() > 1 and np.ptp(det.scores[mask]) == 0
        },
        turned=_turned(det, any_own),
    )


def _first(own: Mask, why: dict[Reason, Mask]) -> dict[Reason, int]:
    """How many of a class each reason is the first for."""
    left, found = own.copy(), {}
    for reason, mask in why.items():
        n = int((left & mask).sum())
        if n:
            found[reason] = n
        left &= ~mask
    return found


def _any(masks: dict[str, Mask], n: int) -> Mask:
    either = np.zeros(n, dtype=bool)
    for mask in masks.values():
        either |= mask
    return either


def _by_name(table: LabelTable) -> dict[str, int]:
    """Objects of each class, most first; what no KITTI label is called under the name that it is written with."""
    found: Counter[str] = Counter()
    for code, n in zip(*np.unique(table.types, return_counts=True), strict=True):
        name = TYPES[code] if code < OTHER else table.others[code - OTHER]
        found[name] += int(n)
    return dict(found.most_common())


def _without_size(table: LabelTable, own: dict[str, Mask]) -> dict[str, int]:
    """Classes none of whose objects has a height, width and length, and their numbers."""
    flat = table.values[:, 7:10].min(axis=1) <= 0
    return {name: int(mask.sum()) for name, mask in own.items() if mask.any() and flat[mask].all()}


def _turned(table: LabelTable, own: Mask) -> int:
    angle = table.values[:, 13]
    return int((own & (np.abs(angle) > TURN) & (angle != UNSET_ANGLE)).sum())
