"""Tables II, III and V of the paper: layout, decimals and bold rule as printed."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import pandas as pd

from fl3d.analysis.found import Judged
from fl3d.core.errors import ConfigError
from fl3d.papers.base import PaperTable, with_values
from fl3d.papers.beside import Published, beside
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.judged_views import intervals_by_level
from fl3d.reports.seeds import PAIRED, better_in_pairs, seeds_note
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Column, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

GAMMA = "loss.gamma"
NORMALIZE = "loss.normalize"
BASE = "better than γ = 0"
BOLD = f"AP in percent; bold: {BASE}"
FORMS = {False: "Original", True: "Enhanced"}
METRICS = list(AP_COLUMNS.values())
# Tables whose rows are gammas: the figures and the claims of the paper are about sweeps that feed one.
OVER_GAMMA = {
    *("focal_loss.last_3d_fcn", "focal_loss.last_voxelnet"),
    *("focal_loss.best_models", "focal_loss.best_of_last_stage"),
}


def gamma_of(trial: FrozenTrial) -> float:
    """Gamma of a trial's loss.

    Raises:
        ConfigError: its loss has none.
    """
    gamma = trial.value(GAMMA)
    if gamma is None:
        raise ConfigError(
            f"sweep.tables: a table over γ needs loss.gamma, which '{' '.join(trial.overrides)}' lacks"
        )
    return float(gamma)


class LastModels(PaperTable):
    """Tables II and III: last models of one detector by gamma.

    Args:
        name: see ``PaperTable``.
        number: likewise.
        detector: whose.
    """

    def __init__(self, name: str, number: str, detector: str) -> None:
        self.name = name
        self.number = number
        self.title = f"Table {number}."
        self.detector = detector

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """Its gamma."""
        return gamma_of(trial) if trial.detector == self.detector else None

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """A row a gamma."""
        models = models_by_gamma(sweeps[0], "last", self)
        if models.empty:
            return None
        base = models[models["gamma"] == 0]
        rows = []
        seeds = {}
        for gamma, own in models.groupby("gamma", sort=True):
            rows.append((Cell(f"{gamma:g}"), *ap_cells(own, base)))
            seeds[f"γ = {gamma:g}"] = own["seed"]
        caption = f"Evaluation results on the validation split for last models of {self.detector}"
        columns = (Column("gamma", "γ"), *APS)
        notes = (*notes, seeds_note(seeds, PAIRED))
        return Table(self.number, caption, columns, tuple(rows), BOLD, notes, title=self.title)

    def beside(self, table: Table) -> Table | None:
        """Rows are matched by gamma."""
        printed = {f"{float(row['gamma']):g}": row for row in records(self.number)}
        published = Published(rows=printed, base_of=lambda key: "0", is_ordered=True)
        return beside(table, [cell.text for cell in table.column("gamma")], published)

    def base_level(self, sweep: FinishedSweep) -> str | None:
        """That of gamma = 0."""
        return self.level_of(sweep, lambda trial: gamma_of(trial) == 0)

    def intervals(self, table: Table, judged: Judged) -> Table | None:
        """Gains over gamma = 0; without it over the sweep's baseline, and None where no trial of that is done."""
        rows = [cell.text for cell in table.column("gamma")]
        bold = f"better than γ = {judged.baseline}" if judged.baseline in rows else BASE
        return intervals_by_level(table, judged, self.detector, bold)


class LossForms(PaperTable):
    """Table V: last models of 3D-FCN under the original loss (sums) and the enhanced one (means, weighed)."""

    name = "focal_loss.loss_forms"
    number = "V"
    title = "Table V."
    detector = "3D-FCN"

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """Whether its loss is normalised."""
        if trial.detector != self.detector:
            return None
        normalize = trial.value(NORMALIZE)
        if normalize is None:
            raise ConfigError(
                f"sweep.tables: {self.title} needs {NORMALIZE}, which '{' '.join(trial.overrides)}' lacks"
            )
        return bool(normalize)

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """Two rows."""
        sweep = sweeps[0]
        chosen = sweep.select("last")
        chosen = with_values(
            sweep, chosen[chosen["trial"].isin(self.rows(sweep))], {"normalize": NORMALIZE}
        )
        if chosen.empty:
            return None
        rows = []
        seeds = {}
        for form, own in chosen.groupby("normalize", sort=True):
            name = FORMS[bool(form)]
            rows.append((Cell(name), *ap_cells(own, chosen[chosen["normalize"] != form])))
            seeds[name] = own["seed"]
        caption = f"Evaluation results of last models of {self.detector} for the original and the enhanced loss"
        legend = "AP in percent; bold: the better one"
        columns = (Column("loss", "Loss"), *APS)
        notes = (*notes, seeds_note(seeds, PAIRED))
        return Table(self.number, caption, columns, tuple(rows), legend, notes, title=self.title)

    def beside(self, table: Table) -> Table | None:
        """Rows are matched by the loss."""
        printed = {row["loss"]: row for row in records(self.number)}
        published = Published(rows=printed, base_of=lambda key: FORMS[False])
        return beside(table, [cell.text for cell in table.column("loss")], published)

    def base_level(self, sweep: FinishedSweep) -> str | None:
        """That of the original loss."""
        return self.level_of(sweep, lambda trial: not self.row_of(trial))

    def intervals(self, table: Table, judged: Judged) -> Table | None:
        """Gains over the original loss, or the enhanced one where it alone is done; None where neither is."""
        is_enhanced = _form(judged.baseline) == FORMS[True]
        bold = f"better than the {FORMS[is_enhanced].lower()}"
        return intervals_by_level(table, judged, self.detector, bold, row_of=_form)


def _form(level: str) -> str:
    """A row of Table V, of a level: a loss by its name, or by whether it is normalised."""
    return FORMS[level == "true"] if level in ("false", "true") else level.capitalize()


LAST_3D_FCN = LastModels("focal_loss.last_3d_fcn", "II", "3D-FCN")
LAST_VOXELNET = LastModels("focal_loss.last_voxelnet", "III", "VoxelNet")
LOSS_FORMS = LossForms()
LAST_TABLES = {table.detector: table for table in (LAST_3D_FCN, LAST_VOXELNET)}


def is_over_gamma(sweep: FinishedSweep) -> bool:
    """Whether a sweep feeds a table over gamma."""
    return bool(OVER_GAMMA & set(sweep.settings.sweep.tables))


def models_by_gamma(sweep: FinishedSweep, rule: str, table: PaperTable) -> pd.DataFrame:
    """Models that have a row in a table, with their ``gamma`` and ``lr``; those of a row differ in their seed alone.

    Raises:
        ConfigError: trials share a row and differ in more than their seed.
    """
    own = table.rows(sweep)
    table.refuse_twins(trial.plan for trial in sweep.trials)
    chosen = sweep.select(rule)
    chosen = with_values(
        sweep, chosen[chosen["trial"].isin(own)], {"gamma": GAMMA, "lr": "optimizer.lr"}
    )
    return chosen.assign(gamma=chosen["gamma"].astype(float))


def by_gamma(sweep: FinishedSweep, rule: str, table: PaperTable) -> pd.DataFrame:
    """Rows of a table by detector and gamma, each the mean of its own seeds; raises as ``models_by_gamma`` does."""
    chosen = models_by_gamma(sweep, rule, table)
    rows = []
    for _, twins in chosen.groupby(["detector", "gamma"], sort=True):
        row = twins.iloc[0].copy()
        for metric in METRICS:
            row[metric] = twins[metric].mean()
        row["step"] = "/".join(str(step) for step in sorted(twins["step"].unique()))
        rows.append(row)
    return pd.DataFrame(rows).reset_index(drop=True)


def ap_cells(own: pd.DataFrame, base: pd.DataFrame) -> list[Cell]:
    """Means of some seeds, two decimals; bold where better than the base."""
    better = better_in_pairs(own, base, METRICS)
    return [Cell(f"{own[m].mean():.2f}", bold) for m, bold in zip(METRICS, better, strict=True)]


def records(name: str) -> list[dict[str, str]]:
    """Rows of a published table, as printed."""
    return [
        {str(key): str(value) for key, value in row.items()}
        for row in published_table(name).to_dict("records")
    ]
