"""Anybody's detectors compared by their result files: APs, gains over one of them, and verdicts from three runs on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from fl3d.analysis import AVERAGES, MARGIN
from fl3d.analysis.comparable import PRIMARY, comparable_classes, notes_on, primary_view
from fl3d.analysis.gains import is_one_step
from fl3d.analysis.result_folders import Held
from fl3d.analysis.samples import (
    CELLS,
    Measured,
    Resampled,
    interval_columns,
    pair_seeds,
    resample_cell,
)
from fl3d.analysis.verdicts import judge_group
from fl3d.core.errors import ConfigError, options
from fl3d.evaluation.bootstrap import N_RESAMPLES
from fl3d.evaluation.intervals import NO_INTERVAL, Interval, Sample, interval, joint_intervals
from fl3d.evaluation.verdicts import FEWEST

Cell = tuple[str, str]  # metric and difficulty
Key = tuple[str, Cell]  # of a detector
# Of each detector and cell, by run from 1 on: (2,) APs, and (R, 2) in the resamples.
Drawn = Mapping[Key, Mapping[int, Resampled]]


@dataclass(frozen=True)
class Compared:
    """What a comparison has found.

    Args:
        held: what was compared.
        baseline: name of the detector that the others are held against.
        classes: that were compared.
        cells: a row for each class, metric, difficulty, average and detector: ``runs``, ``n_gt``, ``ap`` and ``gain``
            with ``_low`` and ``_high``, ``one_r11_step`` and ``marked``. The gains' intervals hold for all detectors
            at once, each cell for itself. NaN where a detector has no such boxes, where no ground truth counts, and for
            gains of the baseline.
            ``marked``: the gain in R40, of three runs at least, differs from zero where all gains of the class are
            looked at together.
        verdicts: a row for each class (``group``) and detector (``level``) that has boxes for the primary metric, see
            ``analysis.verdicts.judge``.
        margin: of the verdicts, AP.
        notes: what a reader must know beside the numbers.
    """

    held: Held
    baseline: str
    classes: tuple[str, ...]
    cells: pd.DataFrame
    verdicts: pd.DataFrame
    margin: float
    notes: tuple[str, ...]

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the detectors but the baseline's."""
        return tuple(name for name in self.held.names if name != self.baseline)

    def primary(self, class_name: str) -> str:
        """View that verdicts on a class are about, see ``primary_view``."""
        return primary_view(self.held, self.baseline, class_name) or PRIMARY[0]


def compare_detectors(
    held: Held,
    baseline: str | None = None,
    classes: Sequence[str] = (),
    margin: float = MARGIN,
    n_resamples: int = N_RESAMPLES,
) -> Compared:
    """AP of every detector, gains over the baseline, and verdicts on detectors of three runs or more.

    Runs are paired by their places: the first of a detector with the first of the baseline.

    Args:
        held: see ``result_folders.hold``.
        baseline: name of the detector that the others are held against; None: the first.
        classes: that are compared; empty: those that the baseline and another detector detect.
        margin: gains below it do not matter, AP.
        n_resamples: of the frames, or of the drives.

    Raises:
        ConfigError: no such detector or class, or nothing to compare.
    """
    base = held.names[0] if baseline is None else baseline
    if base not in held.names:
        raise ConfigError(f"--baseline {base}: no such detector. {options(base, held.names)}")
    chosen = comparable_classes(held, base, classes)
    cells: list[dict[str, Any]] = []
    verdicts: list[dict[str, Any]] = []
    for name in chosen:
        drawn = _draw(held, name, n_resamples)
        cells += _cell_rows(held, base, name, drawn)
        verdicts += _verdict_rows(held, base, name, drawn, margin)
    notes = (*held.notes, *notes_on(held, base, chosen, classes))
    return Compared(held, base, chosen, pd.DataFrame(cells), pd.DataFrame(verdicts), margin, notes)


def _cells(held: Held) -> list[Cell]:
    """Cells that the protocol has."""
    return [cell for cell in CELLS if cell[0] in held.protocol.metrics]


def _draw(held: Held, class_name: str, n_resamples: int) -> Drawn:
    """APs of each detector's runs in every cell that it has boxes for."""
    units = held.units.of_frames
    return {
        (name, cell): {
            number: Resampled(
                *resample_cell(run, cell, units, n_resamples, class_name), run.det.digest
            )
            for number, run in enumerate(held.runs[name], 1)
        }
        for name in held.names
        for cell in _cells(held)
        if cell[0] in held.metrics(name, class_name)
    }


def _sampled(drawn: Drawn, key: Key, baseline: str, average: int) -> tuple[Sample, Sample | None]:
    """AP and gain of a detector's cell; no gain where the baseline has no such boxes."""

    def of(one: Key) -> dict[int, Measured]:
        return {
            n: Measured(float(run.values[average]), run.draws[:, average], run.detections)
            for n, run in drawn[one].items()
        }

    base = (baseline, key[1])
    if base not in drawn:
        return pair_seeds(of(key), of(key))[0], None
    return pair_seeds(of(key), of(base))


def _cell_rows(held: Held, baseline: str, class_name: str, drawn: Drawn) -> list[dict[str, Any]]:
    """Rows of one class, see ``Compared``."""
    any_run = held.runs[baseline][0]
    cells = _cells(held)
    counts = {cell: int(any_run.matches(class_name, *cell).n_gt.sum()) for cell in cells}
    tables = [_average_rows(held, baseline, drawn, place) for place in range(len(AVERAGES))]
    rows = []
    for place, average in enumerate(AVERAGES):
        for name in held.names:
            for cell in cells:
                row: dict[str, Any] = {
                    "class": class_name,
                    "metric": cell[0],
                    "difficulty": cell[1],
                }
                row |= {"average": average, "detector": name, "n_gt": counts[cell]}
                row |= tables[place][name, cell]
                r11, r40 = (table[name, cell]["gain"] for table in tables)
                row["one_r11_step"] = average == "R11" and is_one_step(r11, r40)
                rows.append(row)
    return rows


def _average_rows(held: Held, baseline: str, drawn: Drawn, place: int) -> dict[Key, dict[str, Any]]:
    """AP and gain of all cells of one class in one average: gains of a cell as a family, marks of all cells as one."""
    sampled = {key: _sampled(drawn, key, baseline, place) for key in drawn}
    family = {
        key: gain for key, (_, gain) in sampled.items() if gain is not None and key[0] != baseline
    }
    in_cells = [
        _joint({key: family[key] for key in family if key[1] == cell}) for cell in _cells(held)
    ]
    gains = {key: one for own in in_cells for key, one in own.items()}
    enough = {
        key: gain for key, gain in family.items() if len(gain.values) >= FEWEST and not gain.copies
    }
    is_marked = AVERAGES[place] == "R40"
    marked = {key for key, one in _joint(enough).items() if one.excludes_zero and is_marked}
    rows: dict[Key, dict[str, Any]] = {}
    for key in ((name, cell) for name in held.names for cell in _cells(held)):
        ap = interval(sampled[key][0]).within_percent() if key in sampled else NO_INTERVAL
        n_runs = len(sampled[key][0].values) if key in sampled else len(held.runs[key[0]])
        gain = gains.get(key, NO_INTERVAL)
        rows[key] = {
            "runs": n_runs,
            **interval_columns("ap", ap),
            **interval_columns("gain", gain),
            "marked": key in marked,
        }
    return rows


def _joint(family: Mapping[Key, Sample]) -> dict[Key, Interval]:
    return dict(zip(family, joint_intervals(list(family.values())), strict=True))


def _verdict_rows(
    held: Held, baseline: str, class_name: str, drawn: Drawn, margin: float
) -> list[dict[str, Any]]:
    """Verdicts on one class, as ``analysis.verdicts.judge`` gives them."""
    view = primary_view(held, baseline, class_name)
    cell, place = (str(view), "moderate"), AVERAGES.index("R40")
    pairs = {}
    for name in held.names:
        if (name, cell) in drawn:
            ap, gain = _sampled(drawn, (name, cell), baseline, place)
            if gain is not None:
                pairs[name] = (ap, gain)
    front = {"group": class_name, "metric": f"{view}_r40/moderate"}
    judged = judge_group(pairs, baseline, margin)
    return [{**front, "level": name, **row} for name, row in judged.items()]
