"""Results and the labels that they belong to, by one view of their boxes, to judge what another view says. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.protocol import METRICS

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Pairs:
    """A label and its result in each row.

    Args:
        gt: (K,) rows of the labels' table.
        det: (K,) rows of the results' table.
    """

    gt: Int
    det: Int

    def __len__(self) -> int:
        return len(self.gt)

    def select(self, mask: NDArray[np.bool_]) -> Pairs:
        """Those where ``mask`` (K,) is true."""
        return Pairs(self.gt[mask], self.det[mask])


def overlapping(held: Comparison, name: str, metric: str, least: float) -> Pairs:
    """Of each label of a class the result of that class that overlaps it most, if by so much at least."""
    rows, shared = owners_of(held), held.overlaps.values[METRICS.index(metric)]
    det = held.overlaps.detection
    kept = held.gt.of(name)[rows] & held.det.of(name)[det] & (shared >= least)
    rows, det, shared = rows[kept], det[kept], shared[kept]
    order = np.lexsort((-shared, rows))
    gt, first = np.unique(rows[order], return_index=True)
    return Pairs(gt, det[order][first])


def owners_of(held: Comparison) -> Int:
    """(P,) the label's row of each pair of ``Overlaps``."""
    return np.repeat(np.arange(len(held.gt.types)), np.diff(held.overlaps.offsets))


def near(held: Comparison, name: str, reach: float) -> Pairs:
    """Of each label of a class the result of that class whose centre over ground is nearest, if within ``reach`` m."""
    own = [np.flatnonzero(table.of(name)) for table in (held.gt, held.det)]
    limits = [
        np.searchsorted(rows, table.offsets)
        for rows, table in zip(own, (held.gt, held.det), strict=True)
    ]
    centres = [
        table.boxes_cam[rows][:, [0, 2]]
        for rows, table in zip(own, (held.gt, held.det), strict=True)
    ]
    gt, det = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    has_both = np.flatnonzero((np.diff(limits[0]) > 0) & (np.diff(limits[1]) > 0))
    for frame in has_both:
        of_gt, of_det = (slice(at[frame], at[frame + 1]) for at in limits)
        apart = np.linalg.norm(centres[0][of_gt, None] - centres[1][None, of_det], axis=-1)
        nearest = apart.argmin(axis=1)
        is_near = apart.min(axis=1) <= reach
        gt.append(own[0][of_gt][is_near])
        det.append(own[1][of_det][nearest[is_near]])
    return Pairs(np.concatenate(gt), np.concatenate(det))
