"""Figure 5 of the course report, a table: AP of Frustum ConvNet by the resolutions of slabs that it sees."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from fl3d.papers.base import PaperTable
from fl3d.papers.course_report.frustum_tables import FCONVNET, KITTI_LEVEL, LEVELS
from fl3d.papers.course_report.published_cells import published_table
from fl3d.reports.seeds import seeds_note
from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

USED = "detector.slabs_used"
STRIDES = ("0.25", "0.5", "1", "2")  # metres, of the four resolutions; slabs are twice as high
LOST = (
    "The report takes it from the paper on Frustum ConvNet, where strides and heights are told. Its last two rows have "
    "the same marks: the last is taken for all four resolutions, whose column was lost."
)


class ResolutionsTable(PaperTable):
    """A row a set of resolutions, ours beside the printed cells; first stages."""

    name = "course_report.resolutions"
    number = "R_figure_5"
    title = "Figure 5 of the report."

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """Strides of the resolutions that it sees."""
        if trial.detector != FCONVNET or USED not in trial.values:
            return None
        used = trial.values[USED]
        return ", ".join(STRIDES if used is None else (STRIDES[number] for number in sorted(used)))

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """In the printed order; sets that were not run are left out."""
        (sweep,) = sweeps
        last = sweep.select("last")
        rows, seeds = [], {}
        for printed in published_table(self.number).to_dict("records"):
            strides = str(printed["strides"])
            own = last[last["trial"].isin(self.trials(sweep, strides))]
            if own.empty:
                continue
            ours = [Cell(f"{own[f'ap_3d/{KITTI_LEVEL[level]}'].mean():.2f}") for level in LEVELS]
            theirs = [Cell(str(printed[f"3d_{level}"])) for level in LEVELS]
            rows.append((Cell(strides), *ours, *theirs))
            seeds[strides] = [int(seed) for seed in own["seed"]]
        if not rows:
            return None
        columns = (
            Column("strides", "Strides (m)"),
            *(Column(f"3d_{level}", head, "3D AP, ours", True) for level, head in LEVELS.items()),
            *(
                Column(f"3d_{level}_published", head, "3D AP, report", True)
                for level, head in LEVELS.items()
            ),
        )
        caption = "Frustum ConvNet by the resolutions that it sees: last models of the first stage"
        notes = (*notes, seeds_note(seeds), LOST)
        return Table(
            self.number, caption, columns, tuple(rows), "AP in percent", notes, title=self.title
        )

    def trials(self, sweep: FinishedSweep, strides: str) -> list[str]:
        """Keys of the trials of a row."""
        return [trial.key for trial in sweep.trials if self.row_of(trial.plan) == strides]


RESOLUTIONS = ResolutionsTable()
