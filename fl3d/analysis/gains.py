"""APs of a sweep and their gains over the baseline, with intervals over frames and training seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import (
    CELLS,
    Comparisons,
    Resampled,
    Samples,
    interval_columns,
    paired,
)
from fl3d.core.errors import ConfigError
from fl3d.data.classes import CARS
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.intervals import Sample, interval, joint_intervals
from fl3d.evaluation.recall import OVERLAPS, recall
from fl3d.evaluation.verdicts import FEWEST

R11_STEP = 100 / 11  # what one more of its recall samples is worth in R11
TABLE = ("bev", "3d")  # metrics of a table's cells, which are one family of marks
R11, R40 = (AVERAGES.index(name) for name in ("R11", "R40"))
COLUMNS = [
    *("group", "level", "seeds_done", "metric", "difficulty", "average", "seeds", "copies"),
    *("ap", "ap_low", "ap_high", "gain", "gain_low", "gain_high", "one_r11_step", "marked"),
]


def gains(samples: Samples, baseline: str) -> pd.DataFrame:
    """AP and gain of every level, metric and difficulty, with 95 % intervals, each for itself.

    Args:
        samples: see ``contributions.Contributions.samples``. Groups without the baseline are left out, and so are seeds
            that it lacks.
        baseline: level that the others are held against.

    Returns:
        a row for each group, level, metric, difficulty and average (R11, R40): ``seeds`` that the baseline has too, of
        ``seeds_done``; over these ``ap`` and ``gain`` with ``_low`` and ``_high``, ``one_r11_step``, and ``marked``:
        whether the gain in R40 differs from zero, from three seeds on, where all cells of the group's table are looked
        at together. Seeds that have the same detections are counted once (``copies``), and mark nothing.

    Raises:
        ConfigError: no group has the baseline.
    """
    rows = []
    has_pairs = False
    for group, levels in samples.items():
        base = levels.get(baseline, {})
        own = {level: by_seed for level, by_seed in levels.items() if set(by_seed) & set(base)}
        has_pairs |= bool(own)
        marked = _marked(own, baseline)
        for level, by_seed in own.items():
            front = {"group": group, "level": level, "seeds_done": len(by_seed)}
            for place, (metric, difficulty) in enumerate(CELLS):
                if any(np.isnan(one.values[place]).any() for one in by_seed.values()):
                    continue  # a metric that the protocol does not have, or no ground truth counts
                for row in _cell_rows(by_seed, base, place):
                    cell = {"metric": metric, "difficulty": difficulty}
                    mark = {"marked": (level, place) in marked}
                    rows.append({**front, **cell, **row, **mark})
    if not has_pairs:
        raise ConfigError(
            f"a gain needs a trial of the baseline '{baseline}' that is done, with a seed of the others; "
            "choose another level with sweep.baseline"
        )
    return pd.DataFrame(rows, columns=COLUMNS)  # without rows where no ground truth counts


def _cell_rows(
    side: Mapping[int, Resampled], base: Mapping[int, Resampled], place: int
) -> list[dict[str, object]]:
    """One cell of a level: a row an average."""
    found = [paired(side, base, place, average) for average in (R11, R40)]
    is_step = is_one_step(*(float(np.mean(gain.values)) for _, gain in found))
    rows = []
    for name, (ap, gain) in zip(AVERAGES, found, strict=True):
        row: dict[str, object] = {"average": name, "seeds": len(gain.values)}
        row["copies"] = bool(gain.copies)
        row |= interval_columns("ap", interval(ap).within_percent()) | interval_columns(
            "gain", interval(gain)
        )
        rows.append(row | {"one_r11_step": is_step and name == "R11"})
    return rows


def is_one_step(r11: float, r40: float) -> bool:
    """Whether a gain in R11 is of the size of one of its recall steps while R40 gains less than half as much.

    A step is worth 9.09 times the precision there; less is lost or won elsewhere.
    """
    return bool(R11_STEP / 4 < abs(r11) < R11_STEP * 1.5 and r40 * np.sign(r11) < abs(r11) / 2)


def _marked(levels: Mapping[str, Mapping[int, Resampled]], baseline: str) -> set[tuple[str, int]]:
    """Levels and cells of a group's table whose gains in R40 differ from zero, all at once."""
    base = levels.get(baseline, {})
    places = [place for place, (metric, _) in enumerate(CELLS) if metric in TABLE]
    family: dict[tuple[str, int], Sample] = {}
    for level, by_seed in levels.items():
        if level != baseline and len(set(by_seed) & set(base)) >= FEWEST:
            for place in places:
                gain = paired(by_seed, base, place, R40)[1]
                if not gain.copies:
                    family[level, place] = gain
    found = joint_intervals(list(family.values()))
    return {key for key, one in zip(family, found, strict=True) if one.excludes_zero}


def recalls(compared: Comparisons, classes: Sequence[str] = CARS) -> pd.DataFrame:
    """Recall of the final boxes at 3D overlaps 0.1 to 0.9, over all labels; a row a trial.

    Args:
        compared: see ``samples.compare_sweep``.
        classes: whose mean recall it is: of those that have labels.
    """
    rows = []
    for group, levels in compared.items():
        for level, by_seed in levels.items():
            for seed, comparison in sorted(by_seed.items()):
                labelled = [name for name in classes if comparison.gt.of(name).any()]
                shares = np.mean([_recall(comparison, n) for n in labelled or classes], axis=0)
                columns = {
                    f"recall_{overlap:g}": share
                    for overlap, share in zip(OVERLAPS, shares, strict=True)
                }
                rows.append({"group": group, "level": level, "seed": seed, **columns})
    return pd.DataFrame(rows)


def _recall(comparison: Comparison, name: str) -> NDArray[np.float64]:
    own = comparison.det.of(name)
    return recall(comparison.gt, comparison.overlaps, name, own=own)


def without_baseline(compared: Comparisons, baseline: str) -> list[str]:
    """Groups that have no gain: no trial of the baseline in them is done."""
    return [group for group, levels in compared.items() if baseline not in levels]
