"""Tables 1 to 5 of the course report: recall of PointRCNN's boxes, beside what it printed."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any, ClassVar

import pandas as pd

from fl3d.core.errors import ConfigError
from fl3d.evaluation.selection import select
from fl3d.papers.base import PaperTable
from fl3d.papers.course_report.published_cells import published_table
from fl3d.reports.seeds import UNPAIRED, seeds_note
from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

OVERLAPS = ("0.1", "0.3", "0.5", "0.7", "0.9")
KEYS = [f"recall_3d/{overlap}" for overlap in OVERLAPS]  # of scores
NETWORKS = (
    "Box Proposal",
    "Box Refinement",
)  # last checkpoints of the first and of the second stage
LEGEND = "Recall of cars by 3D overlap"

Front = tuple[str, ...]


class RecallTable(PaperTable):
    """A table of recalls, ours on the left and the printed cells on the right; seeds are averaged.

    Attributes:
        caption: of it.
        heads: of its front columns, by their names in the published file.
        has_networks: whether proposals and refined boxes have rows of their own.
        has_bold: whether the best of a column is set in bold.
    """

    caption: str
    heads: ClassVar[Mapping[str, str]] = {}
    has_networks = False
    has_bold = True

    def __init__(self, number: int, name: str) -> None:
        self.number = f"R{number}"
        self.name = f"course_report.{name}"
        self.title = f"Table {number} of the report."

    def front(self, trial: FrozenTrial) -> Front:
        """Texts of the front columns of a trial's row."""
        return ()

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """Its front columns."""
        return self.front(trial)

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """A row a setting, or two where proposals and refined boxes are told apart."""
        rows = self._rows(sweeps[0])
        heads = {**self.heads, **({"network": "Network"} if self.has_networks else {})}
        printed = {
            tuple(row[key] for key in heads): row
            for row in published_table(self.number).to_dict("records")
        }
        best = _best(list(rows.values())) if self.has_bold else [None] * len(OVERLAPS)
        cells = []
        for front, values in rows.items():
            ours = [
                Cell(text, bold=float(text) == best[place]) for place, text in enumerate(values)
            ]
            cells.append((*(Cell(text) for text in front), *ours, *_printed(printed.get(front))))
        columns = (
            *(Column(key, head) for key, head in heads.items()),
            *(Column(f"iou_{overlap}", overlap, "IoU, ours", True) for overlap in OVERLAPS),
            *(
                Column(f"iou_{overlap}_published", overlap, "IoU, report", True)
                for overlap in OVERLAPS
            ),
        )
        legend = f"{LEGEND}; bold: best of its column" if self.has_bold else LEGEND
        notes = (*notes, self._seeds(sweeps[0]))
        return Table(
            self.number, self.caption, columns, tuple(cells), legend, notes, title=self.title
        )

    def _seeds(self, sweep: FinishedSweep) -> str:
        """Of how many seeds the rows are."""
        seeds: dict[str, list[int]] = {}
        for trial in sweep.trials:
            seeds.setdefault(" / ".join(self.front(trial.plan)), []).append(trial.seed)
        return seeds_note(seeds, UNPAIRED if self.has_bold else "")

    def _rows(self, sweep: FinishedSweep) -> dict[Front, list[str]]:
        """Printed recalls by front texts, in the order of what they are swept over."""
        means = {row: own[KEYS].mean() for row, own in self.models(sweep).items()}
        return {row: [f"{own[key]:.3f}" for key in KEYS] for row, own in means.items()}

    def models(self, sweep: FinishedSweep) -> dict[Front, pd.DataFrame]:
        """The scores that each row is the mean of, one a seed, in the order of what they are swept over."""
        fronts = {trial.key: self.front(trial.plan) for trial in sweep.trials}
        parts = [(NETWORKS[1], sweep.select("last"))]
        if self.has_networks:
            first = sweep.scores[sweep.scores["step"] <= sweep.scores["first_own_step"]]
            parts = [(NETWORKS[0], select(first, "last")), *parts]
        found: dict[Front, pd.DataFrame] = {}
        for front in sorted(set(fronts.values()), key=_by_number):
            for network, rows in parts:
                row = (*front, network) if self.has_networks else front
                found[row] = rows[rows["trial"].map(fronts) == front]
        return found


class ByNetwork(RecallTable):
    """Table 1."""

    caption = "Recall of PointRCNN under its authors' loss"
    has_networks = True
    has_bold = False


class ByBatch(RecallTable):
    """Table 2."""

    caption = "Recall of proposals by batch size"
    heads: ClassVar[Mapping[str, str]] = {"batch_size": "Batch Size"}

    def front(self, trial: FrozenTrial) -> Front:
        """Frames in a step of the first stage."""
        return (str(value_of(trial, "schedule.stages.rpn.set.schedule.batch_size")),)


class ByAlpha(RecallTable):
    """Table 3."""

    caption = "Recall of proposals by alpha"
    heads: ClassVar[Mapping[str, str]] = {"alpha_fg": "α foreground", "alpha_bg": "α background"}

    def front(self, trial: FrozenTrial) -> Front:
        """Weights of foreground and background."""
        alpha = float(value_of(trial, "loss.alpha"))
        return f"{alpha:.2f}", f"{1 - alpha:.2f}"


class ByBins(RecallTable):
    """Table 4."""

    caption = "Recall of proposals by search range and bin"
    heads: ClassVar[Mapping[str, str]] = {"search_range": "Search Range", "bin_size": "Bin Size"}

    def front(self, trial: FrozenTrial) -> Front:
        """Search range and bin of the first stage, metres."""
        return tuple(
            f"{float(value_of(trial, f'detector.rpn.{key}')):g}m" for key in ("search", "bin")
        )


class ByRcnnBin(RecallTable):
    """Table 5."""

    caption = "Recall of boxes by the second stage's bin"
    heads: ClassVar[Mapping[str, str]] = {"rcnn_bin_size": "Bin Size"}
    has_networks = True

    def front(self, trial: FrozenTrial) -> Front:
        """Bin of the second stage, metres."""
        return (f"{float(value_of(trial, 'detector.rcnn.bin')):g} m",)


RECALL_TABLES = (
    ByNetwork(1, "authors_loss"),
    ByBatch(2, "batch_size"),
    ByAlpha(3, "alpha"),
    ByBins(4, "bins"),
    ByRcnnBin(5, "rcnn_bin"),
)


def value_of(trial: FrozenTrial, key: str) -> Any:
    """A value of a trial's config that a table's rows are told by.

    Raises:
        ConfigError: the config has no such key.
    """
    value = trial.value(key)
    if value is None:
        raise ConfigError(
            f"sweep.tables: this table needs {key}, which '{' '.join(trial.overrides)}' lacks"
        )
    return value


def _best(rows: Sequence[Sequence[str]]) -> list[float | None]:
    """The highest of each column; None where all are equal, for then none is best."""
    best: list[float | None] = []
    for place in range(len(OVERLAPS)):
        values = {float(row[place]) for row in rows}
        best.append(max(values) if len(values) > 1 else None)
    return best


def _printed(row: Mapping[Hashable, Any] | None) -> list[Cell]:
    keys = [f"iou_{overlap}" for overlap in OVERLAPS]
    if row is None:
        return [Cell("") for _ in keys]
    return [Cell(str(row[key]), row[f"{key}_bold"] == "1") for key in keys]


def _by_number(front: Front) -> tuple[float, ...]:
    """Fronts in the printed order: batch, alpha rise; search ranges and bins fall."""
    values = [float(text.rstrip("m ")) for text in front]
    return tuple(
        -value if text.endswith("m") else value for text, value in zip(front, values, strict=True)
    )
