"""Where detectors differ: what each finds of near and far, hidden, turned and thinly hit objects, and in which frames.

Detectors are compared where each makes equally many false alarms, so that a careless one gains nothing by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.compare import Compared
from fl3d.analysis.samples import Float, Measured, Resampled, interval_columns, pair_seeds
from fl3d.data.label_table import LabelTable
from fl3d.evaluation.at_score import AtScore, at_score, score_of_alarms
from fl3d.evaluation.bootstrap import N_RESAMPLES, unit_weights, widened
from fl3d.evaluation.intervals import interval
from fl3d.runs.units import Units

ALARMS = 0.25  # false alarms a frame; on KITTI's validation frames Point-GNN's precision there is 0.89 (Car, 3D)
DIFFICULTY = "hard"  # of all objects that count anywhere
CHUNK = 500  # resamples at a time: with all of KITTI's validation frames 8 MB of weights
METRES = (0, 10, 20, 30, 40, 50)
POINTS = (0, 1, 5, 20, 100, 500)
SIDES = np.sin(
    np.pi / 4
)  # an object is seen from its side where its heading is 45 to 135 degrees off the line of sight
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """One way to tell objects apart.

    Args:
        name: such as ``distance``.
        bins: their names, in order.
        of_objects: (G,) the bin of each ground truth; -1: none.
    """

    name: str
    bins: tuple[str, ...]
    of_objects: Int


def parts_of(gt: LabelTable, points: Int | None = None) -> list[Part]:
    """Ground truths by distance, by occlusion, by the side from which they are seen, and by points on them.

    Args:
        gt: of all frames.
        points: (G,) LiDAR points within each; None: not known.
    """
    x, z = gt.values[:, 10], gt.values[:, 12]
    turned = np.sin(
        gt.values[:, 13] - np.arctan2(x, z)
    )  # 1: it faces the camera, -1: it drives away
    side = np.where(turned > SIDES, 0, np.where(turned < -SIDES, 2, 1))
    hidden = gt.values[:, 1].astype(np.int64)
    parts = [
        Part("distance", _names(METRES, "m"), _bin_of(np.hypot(x, z), METRES)),
        Part(
            "occlusion",
            ("fully visible", "partly", "largely"),
            np.where(hidden > 2, -1, np.maximum(hidden, -1)),
        ),
        Part("seen from", ("front", "side", "back"), side),
    ]
    if points is not None:
        parts.append(Part("points on it", _names(POINTS, "", whole=True), _bin_of(points, POINTS)))
    return parts


def _bin_of(values: Float | Int, edges: tuple[int, ...]) -> Int:
    return np.searchsorted(edges, values, side="right") - 1


def _names(edges: tuple[int, ...], unit: str, whole: bool = False) -> tuple[str, ...]:
    """``0–10 m``; of whole numbers ``1–4`` and ``0``."""
    names = []
    for low, high in pairwise(edges):
        last = high - 1 if whole else high
        names.append(f"{low}" if whole and low == last else f"{low}–{last} {unit}".rstrip())
    return (*names, f"from {edges[-1]} {unit}".rstrip())


def cuts(compared: Compared, class_name: str) -> dict[str, list[AtScore]]:
    """What each run of each detector finds at its score of equally many false alarms, in the primary view.

    Detectors without boxes for it are left out.
    """
    held, view = compared.held, compared.primary(class_name)
    allowed = int(ALARMS * len(held.ids))
    found: dict[str, list[AtScore]] = {}
    for name in held.names:
        if view not in held.metrics(name, class_name):
            continue
        cell = (class_name, view, DIFFICULTY)
        found[name] = [
            at_score(run, *cell, score_of_alarms(run.matches(*cell), allowed))
            for run in held.runs[name]
        ]
    return found


def found_by_part(
    compared: Compared, class_name: str, points: Int | None = None, n_resamples: int = N_RESAMPLES
) -> pd.DataFrame:
    """Share of the ground truths of each part that each detector finds, and how much more than the baseline.

    Args:
        compared: see ``compare.compare_detectors``.
        class_name: one of its classes.
        points: (G,) LiDAR points within each ground truth; None: not known.
        n_resamples: of the frames, or of the drives.

    Returns:
        a row for each part (``by``), ``bin`` and ``detector``: ``n_gt``, ``found`` and ``gain`` in percent, with 95 %
        intervals each for itself; NaN where a part holds no ground truth.
    """
    at = cuts(compared, class_name)
    gt = compared.held.runs[compared.baseline][0].gt
    rows = []
    for part in parts_of(gt, points):
        drawn = {
            name: {
                number: Resampled(
                    *_shares(one, part, gt, compared.held.units, n_resamples), run.det.digest
                )
                for number, (one, run) in enumerate(
                    zip(runs, compared.held.runs[name], strict=True)
                )
            }
            for name, runs in at.items()
        }
        counting = at[compared.baseline][0].counts & (part.of_objects >= 0)
        counts = np.bincount(part.of_objects[counting], minlength=len(part.bins))
        for place, one_bin in enumerate(part.bins):
            for name, runs in drawn.items():
                row: dict[str, object] = {
                    "class": class_name,
                    "by": part.name,
                    "bin": one_bin,
                    "detector": name,
                }
                row["n_gt"] = int(counts[place])
                rows.append(row | _share_columns(runs, drawn[compared.baseline], place))
    return pd.DataFrame(rows)


Shares = Mapping[int, Resampled]  # of each run (B,), and (R, B) in the resamples


def _share_columns(side: Shares, base: Shares, place: int) -> dict[str, object]:
    def of(runs: Shares) -> dict[int, Measured]:
        return {
            n: Measured(float(one.values[place]), one.draws[:, place], one.detections)
            for n, one in runs.items()
        }

    share, gain = pair_seeds(of(side), of(base))
    return interval_columns("found", interval(share).within_percent()) | interval_columns(
        "gain", interval(gain)
    )


def _shares(
    at: AtScore, part: Part, gt: LabelTable, units: Units, n_resamples: int
) -> tuple[Float, Float]:
    """Found in percent of each bin: (B,) on the frames as they are, (R, B) in each resample."""
    is_counted = (at.found >= 0) & (part.of_objects >= 0)
    unit = units.of_frames[gt.frame[is_counted]]
    own, found = part.of_objects[is_counted], at.found[is_counted]
    counts = np.zeros((2, units.count, len(part.bins)))
    np.add.at(counts[0], (unit, own), found)
    np.add.at(counts[1], (unit, own), 1)
    total = counts.sum(axis=1)
    values = _percent(total[0], total[1])
    weights = unit_weights(units.count, n_resamples)
    draws = np.concatenate(
        [
            _percent(*(weights[start : start + CHUNK].astype(float) @ counts))
            for start in range(0, n_resamples, CHUNK)
        ]
    )
    draws = np.where(np.isnan(draws), values, draws)  # no such object was drawn
    is_drives = units.count < len(units.of_frames)
    return values, widened(draws, units.of_frames) if is_drives else draws


def _percent(part: Float, whole: Float) -> Float:
    return np.divide(100 * part, whole, out=np.full(part.shape, np.nan), where=whole > 0)


def changed_frames(compared: Compared, class_name: str, other: str) -> pd.DataFrame:
    """What a detector finds more than the baseline in each frame, and the false alarms that it makes less.

    Both are cut as in ``found_by_part``; the first run of each stands for it.

    Returns:
        a row for each frame, the largest gain first: ``frame``, ``place`` among the frames, ``n_gt``, ``found`` and
        ``alarms`` of both (``_base`` for the baseline), ``change``: found minus alarms, less the same of the baseline.
    """
    at = cuts(compared, class_name)
    held = compared.held
    columns: dict[str, object] = {"frame": held.ids, "place": np.arange(len(held.ids))}
    for name, end in ((other, ""), (compared.baseline, "_base")):
        run, one = held.runs[name][0], at[name][0]
        frame, of_box = run.gt.frame, run.det.frame
        n = len(held.ids)
        columns["n_gt"] = np.bincount(frame[one.counts], minlength=n)
        columns[f"found{end}"] = np.bincount(frame[one.found == 1], minlength=n)
        columns[f"alarms{end}"] = np.bincount(of_box[one.alarm], minlength=n)
    rows = pd.DataFrame(columns)
    gained = rows["found"] - rows["found_base"] - rows["alarms"] + rows["alarms_base"]
    return rows.assign(change=gained).sort_values("change", ascending=False, kind="stable")
