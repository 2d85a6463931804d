"""Table IV of the paper, best models: as it chooses them, and of the last stage alone."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import pandas as pd

from fl3d.analysis.found import Judged
from fl3d.evaluation.selection import BEST_OF_LAST_STAGE, MEAN_3D
from fl3d.papers.base import PaperTable
from fl3d.papers.beside import Published, beside
from fl3d.papers.focal_loss.published_cells import ARXIV
from fl3d.papers.focal_loss.tables import (
    BASE,
    BOLD,
    METRICS,
    ap_cells,
    by_gamma,
    gamma_of,
    models_by_gamma,
    records,
)
from fl3d.reports.intervals import with_intervals
from fl3d.reports.seeds import PAIRED, better_in_pairs, seeds_note
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Column, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

SELECTED = (
    "Checkpoint and γ were chosen on these frames, which the intervals do not cover: no gain is marked here, and bold "
    "alone says nothing (choosing among equals makes four of five cells bold)."
)


class BestModels(PaperTable):
    """Table IV: for each detector the best model with gamma = 0 and the best with any gamma > 0.

    The paper chooses "among all intermediate weights", those before the focal loss too, which all gammas share.
    """

    name = "focal_loss.best_models"
    number = "IV"
    title = "Table IV."
    rule = "best"
    caption = "Evaluation results on the validation split for best models"

    def row_of(self, trial: FrozenTrial) -> Hashable:
        """Its detector and gamma; the table chooses among these."""
        return trial.detector, gamma_of(trial)

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """Two rows a detector."""
        pairs = best_pairs(sweeps[0], self)
        if pairs.empty:
            return None
        models = models_by_gamma(sweeps[0], self.rule, self)
        rows = []
        seeds = {}
        for _, row in pairs.iterrows():
            same = models[models["detector"] == row["detector"]]
            own = same[same["gamma"] == row["gamma"]]
            rows.append((*_front_cells(row), *ap_cells(own, same[same["gamma"] == 0])))
            seeds[f"{row['detector']} γ = {row['gamma']:g}"] = own["seed"]
        columns = (
            Column("detector", "Detector"),
            Column("gamma", "γ"),
            Column("lr", "lr"),
            Column("step", "Step"),
            *APS,
        )
        chosen = among_note(models, pairs, self.looks_at_all(sweeps[0]))
        notes = (*notes, chosen, seeds_note(seeds, PAIRED))
        order = ("detector", "lr", "step", "gamma", *AP_COLUMNS)
        return Table(
            self.number, self.caption, columns, tuple(rows), BOLD, notes, order, title=self.title
        )

    def looks_at_all(self, sweep: FinishedSweep) -> bool:
        """Whether a model is the best of its trial's whole curve."""
        return sweep.settings.best_among == "all"

    def beside(self, table: Table) -> Table | None:
        """Rows are matched by detector and by whether gamma is 0: our best gamma may be another."""
        printed = {_best_key(row["detector"], row["gamma"]): row for row in records(self.number)}
        arxiv = {
            _best_key(row["detector"], row["gamma"]): row for row in records(ARXIV[self.number])
        }
        published = Published(rows=printed, base_of=_best_base, earlier=arxiv)
        pairs = zip(table.column("detector"), table.column("gamma"), strict=True)
        keys = [_best_key(detector.text, gamma.text) for detector, gamma in pairs]
        theirs = [
            f"{r['detector']} γ = {r['gamma']}, lr {r['lr']}, step {r['step']}"
            for r in printed.values()
        ]
        return beside(table, keys, published, (f"The paper's rows: {'; '.join(theirs)}.",))

    def base_level(self, sweep: FinishedSweep) -> str | None:
        """That of gamma = 0."""
        return self.level_of(sweep, lambda trial: gamma_of(trial) == 0)

    def intervals(self, table: Table, judged: Judged) -> Table:
        """APs of the best models, and no marks: checkpoint and gamma were chosen on the frames that judge them."""
        gains = judged.gains
        rows = gains.assign(row=gains["group"] + " " + gains["level"])
        view = with_intervals(table, rows, BASE, key_columns=2)
        return view.with_notes(*view.notes, SELECTED)


class BestOfLastStage(BestModels):
    """Table IV with models that each gamma's own training made: the best of a trial's last stage."""

    name = "focal_loss.best_of_last_stage"
    number = "IV_last_stage"
    title = "Table IV, last stage alone."
    rule = BEST_OF_LAST_STAGE
    caption = "Evaluation results on the validation split for the best models of the last stage"

    def looks_at_all(self, sweep: FinishedSweep) -> bool:
        """It never does."""
        return False

    def beside(self, table: Table) -> Table | None:
        """The paper has no such table."""
        return None


BEST_MODELS = BestModels()
BEST_OWN_MODELS = BestOfLastStage()


def best_pairs(sweep: FinishedSweep, table: PaperTable) -> pd.DataFrame:
    """Of each detector the best model with gamma = 0 and, of all gamma > 0, the one of highest mean 3D AP.

    Args:
        sweep: the sweep.
        table: whose rule says what the best is: Table IV, or the one of the last stage.
    """
    every = by_gamma(sweep, table.rule, table)
    pairs = []
    for detector in sorted(every["detector"].unique()) if len(every) else ():
        chosen = every[every["detector"] == detector]
        base = _baseline(chosen)
        focal = chosen[chosen["gamma"] > 0]
        pairs += [] if base is None else [base]
        if len(focal):
            pairs.append(focal.iloc[int(focal[MEAN_3D].mean(axis=1).to_numpy().argmax())])
    return pd.DataFrame(pairs).reset_index(drop=True)


def improvements(sweep: FinishedSweep, table: PaperTable) -> list[bool]:
    """Of each AP of each detector, whether the best focal model is better than the one with gamma = 0.

    Seeds that both have are compared, as bold does.

    Args:
        sweep: the sweep.
        table: see ``best_pairs``.
    """
    pairs = best_pairs(sweep, table)
    models = models_by_gamma(sweep, table.rule, table)
    found: list[bool] = []
    for detector, pair in pairs.groupby("detector") if len(pairs) else ():
        if len(pair) == 2:
            same = models[models["detector"] == detector]
            base, focal = (same[same["gamma"] == gamma] for gamma in pair["gamma"])
            found += better_in_pairs(focal, base, METRICS)
    return found


def _baseline(chosen: pd.DataFrame) -> pd.Series | None:
    """The row with gamma = 0."""
    zero = chosen[chosen["gamma"] == 0]
    return zero.iloc[0] if len(zero) else None


def among_note(models: pd.DataFrame, pairs: pd.DataFrame, looks_at_all: bool) -> str:
    """Among which checkpoints the best were chosen, and which of them a focal loss has not trained.

    Args:
        models: chosen checkpoints, a row a trial, with ``step`` and ``first_own_step``.
        pairs: rows of the table: ``detector`` and ``gamma``.
        looks_at_all: whether they were chosen among all checkpoints of a trial; else of its last stage.
    """
    if not looks_at_all:
        return "Best of the checkpoints of each trial's last stage."
    told = "Best of all checkpoints of each trial"
    earlier = []
    for detector, gamma in zip(pairs["detector"], pairs["gamma"], strict=True):
        own = models[(models["detector"] == detector) & (models["gamma"] == gamma)]
        is_earlier = own["step"] <= own["first_own_step"]
        if is_earlier.any():
            earlier.append(f"{detector} γ = {gamma:g} ({is_earlier.sum()} of {len(own)})")
    if earlier:
        return (
            f"{told}; of these are of an earlier stage, which all γ share: {', '.join(earlier)}. In a seed where "
            "both rows are the same checkpoint there is no gain."
        )
    has_earlier = (models["first_own_step"] > 0).any()
    return f"{told}; all of these rows are of its last stage." if has_earlier else f"{told}."


def _front_cells(row: pd.Series) -> list[Cell]:
    steps = row["step"].split("/")
    printed = "/".join(f"{int(s) / 1000:.0f}k" if int(s) >= 10_000 else s for s in steps)
    lr = Cell(format_lr(float(row["lr"])), raw=f"{row['lr']:g}")
    return [Cell(row["detector"]), Cell(f"{row['gamma']:g}"), lr, Cell(printed, raw=row["step"])]


def format_lr(lr: float) -> str:
    """As the paper prints it: 0.01 -> ``1e-2``, 0.0025 -> ``2.5e-3``."""
    mantissa, exponent = f"{lr:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def _best_key(detector: str, gamma: str) -> str:
    return f"{detector} {'base' if float(gamma) == 0 else 'focal'}"


def _best_base(key: str) -> str:
    return f"{key.rpartition(' ')[0]} base"
