"""Tables II to V of the paper from scores: layout, decimals and bold rule as printed. Pure."""

from __future__ import annotations

import pandas as pd

from fl3d.errors import ConfigError
from fl3d.reports.recall_tables import LAYOUTS, recall_table
from fl3d.reports.report_tables import detectors_table, frustum_table
from fl3d.reports.selection import MEAN_3D, select
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Column, Table

LAST_TABLES = {"II": "3D-FCN", "III": "VoxelNet"}
NUMBERS = (*LAST_TABLES, "IV", "V")
BOLD = "AP in percent; bold: better than γ = 0"
FORMS = {False: "Original", True: "Enhanced"}
FORM_DETECTOR = "3D-FCN"


def last_models(scores: pd.DataFrame, number: str, notes: tuple[str, ...] = ()) -> Table:
    """Table II (3D-FCN) or III (VoxelNet): last models by gamma.

    Args:
        scores: see ``selection.select``; further columns ``detector`` and ``gamma``.
        number: ``II`` or ``III``; ``gamma``: of the first detector, which the paper has not.
        notes: put below.
    """
    detector = LAST_TABLES.get(number) or str(scores["detector"].iloc[0])
    chosen = by_gamma(select(scores[scores["detector"] == detector], "last"), number)
    base = baseline(chosen)
    rows = tuple((Cell(f"{row['gamma']:g}"), *_ap_cells(row, base)) for _, row in chosen.iterrows())
    caption = f"Evaluation results on the validation split for last models of {detector}"
    name = number if number in LAST_TABLES else f"gamma-{detector.lower()}"
    return Table(name, caption, (Column("gamma", "γ"), *APS), rows, BOLD, notes)


def best_pairs(scores: pd.DataFrame, stages: str = "last") -> pd.DataFrame:
    """Of each detector the best model with gamma = 0 and, of all gamma > 0, the one of highest mean 3D AP."""
    pairs = []
    for detector in sorted(scores["detector"].unique()):
        chosen = by_gamma(select(scores[scores["detector"] == detector], "best", stages), "IV")
        base, focal = baseline(chosen), chosen[chosen["gamma"] > 0]
        pairs += [] if base is None else [base]
        if len(focal):
            pairs.append(focal.iloc[int(focal[MEAN_3D].mean(axis=1).to_numpy().argmax())])
    return pd.DataFrame(pairs).reset_index(drop=True)


def best_models(scores: pd.DataFrame, stages: str = "last", notes: tuple[str, ...] = ()) -> Table:
    """Table IV: for each detector the best model with gamma = 0 and the best with any gamma > 0.

    Args:
        scores: see ``selection.select``; further columns ``detector``, ``gamma`` and ``lr``, the base rate.
        stages: see ``selection.select``.
        notes: put below.
    """
    rows, pairs = [], best_pairs(scores, stages)
    for _, row in pairs.iterrows():
        base = baseline(pairs[pairs["detector"] == row["detector"]])
        rows.append((*_front_cells(row), *_ap_cells(row, base)))
    columns = (Column("detector", "Detector"), Column("gamma", "γ"), Column("lr", "lr"), Column("step", "Step"), *APS)
    caption = "Evaluation results on the validation split for best models"
    order = ("detector", "lr", "step", "gamma", *AP_COLUMNS)
    return Table("IV", caption, columns, tuple(rows), BOLD, notes, order)


def loss_forms(scores: pd.DataFrame, notes: tuple[str, ...] = ()) -> Table:
    """Table V: last models of 3D-FCN under the original loss (sums) and the enhanced one (means, weighed)."""
    chosen = select(scores[scores["detector"] == FORM_DETECTOR], "last")
    means = chosen.groupby("normalize", sort=True)[list(AP_COLUMNS.values())].mean().reset_index()
    rows = []
    for _, row in means.iterrows():
        others = means[means["normalize"] != row["normalize"]]
        rows.append((Cell(FORMS[bool(row["normalize"])]), *_ap_cells(row, others.iloc[0] if len(others) else None)))
    caption = f"Evaluation results of last models of {FORM_DETECTOR} for the original and the enhanced loss"
    return Table(
        "V", caption, (Column("loss", "Loss"), *APS), tuple(rows), "AP in percent; bold: the better one", notes
    )


def make_tables(
    scores: pd.DataFrame, numbers: tuple[str, ...] = (), stages: str = "last", notes: tuple[str, ...] = ()
) -> list[Table]:
    """Tables of the paper, as far as there are scores for them.

    Args:
        scores: tidy.
        numbers: which; none: those of the gamma sweep.
        stages: see ``selection.select``.
        notes: put below each.
    """
    present = set(scores["detector"])
    made: list[Table] = []
    for number in numbers or (*LAST_TABLES, "IV"):
        if number == "gamma" or (number in LAST_TABLES and LAST_TABLES[number] in present):
            made.append(last_models(scores, number, notes))
        elif number == "R6":
            made.append(frustum_table(scores, notes))
        elif number == "R7":
            made.append(detectors_table(scores, notes))
        elif number in LAYOUTS:
            made.append(recall_table(scores, number, notes))
        elif number == "IV":
            made.append(best_models(scores, stages, notes))
        elif number == "V" and FORM_DETECTOR in present:
            made.append(loss_forms(scores, notes))
    return made


def by_gamma(chosen: pd.DataFrame, number: str) -> pd.DataFrame:
    """Rows by gamma; trials that differ in their seed alone are averaged, other twins are refused."""
    rows = []
    for gamma, twins in chosen.groupby("gamma", sort=True):
        if twins["seed"].duplicated().any():
            differing = [c for c in ("lr", "alpha", "beta", "eta") if twins[c].nunique() > 1]
            raise ConfigError(
                f"Table {number}: {len(twins)} trials with gamma {gamma:g} differ in "
                f"{', '.join(differing) or 'other keys'}; "
                "the table has one row for each gamma (seeds are averaged), so sweep one thing at a time"
            )
        row = twins.iloc[0].copy()
        for metric in AP_COLUMNS.values():
            row[metric] = twins[metric].mean()
        row["step"] = "/".join(str(step) for step in sorted(twins["step"].unique()))
        rows.append(row)
    return pd.DataFrame(rows).reset_index(drop=True)


def baseline(chosen: pd.DataFrame) -> pd.Series | None:
    """The row with gamma = 0."""
    zero = chosen[chosen["gamma"] == 0]
    return zero.iloc[0] if len(zero) else None


def is_better(value: float, than: float) -> bool:
    """The paper's bold rule: the printed number is strictly above the printed one."""
    return float(f"{value:.2f}") > float(f"{than:.2f}")


def _ap_cells(row: pd.Series, base: pd.Series | None) -> list[Cell]:
    """Two decimals; bold where better than the base."""
    metrics = AP_COLUMNS.values()
    return [Cell(f"{row[m]:.2f}", base is not None and is_better(row[m], base[m])) for m in metrics]


def _front_cells(row: pd.Series) -> list[Cell]:
    printed = "/".join(f"{int(s) / 1000:.0f}k" if int(s) >= 10_000 else s for s in row["step"].split("/"))
    lr = Cell(format_lr(float(row["lr"])), raw=f"{row['lr']:g}")
    return [Cell(row["detector"]), Cell(f"{row['gamma']:g}"), lr, Cell(printed, raw=row["step"])]


def format_lr(lr: float) -> str:
    """As the paper prints it: 0.01 -> ``1e-2``, 0.0025 -> ``2.5e-3``."""
    mantissa, exponent = f"{lr:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"
