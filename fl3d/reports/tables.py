"""Tables II, III and IV of the paper from scores: layout, decimals and bold rule as printed. Pure."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import pandas as pd

from fl3d.errors import ConfigError
from fl3d.reports.selection import MEAN_3D, select

AP_COLUMNS = {
    f"{view}_{level}": f"ap_{view}/{level}" for view in ("bev", "3d") for level in ("easy", "moderate", "hard")
}
LAST_TABLES = {"II": "3D-FCN", "III": "VoxelNet"}


@dataclass(frozen=True)
class Cell:
    """One cell.

    Args:
        text: as printed.
        bold: whether it beats gamma = 0 of the same column.
        raw: for CSV, where it differs from the text.
    """

    text: str
    bold: bool = False
    raw: str | None = None


@dataclass(frozen=True)
class Table:
    """A table of the paper.

    Args:
        number: Roman.
        caption: one sentence.
        columns: names for CSV; the last six are the APs.
        rows: cells.
        notes: what a reader must know beside the numbers.
    """

    number: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def last_models(scores: pd.DataFrame, number: str, notes: tuple[str, ...] = ()) -> Table:
    """Table II (3D-FCN) or III (VoxelNet): last models by gamma.

    Args:
        scores: see ``selection.select``; further columns ``detector`` and ``gamma``.
        number: ``II`` or ``III``.
        notes: put below.
    """
    detector = LAST_TABLES[number]
    chosen = _one_row_each(select(scores[scores["detector"] == detector], "last"), number)
    base = _baseline(chosen)
    rows = tuple((Cell(f"{row['gamma']:g}"), *_ap_cells(row, base)) for _, row in chosen.iterrows())
    caption = f"Evaluation results on the validation split for last models of {detector}"
    return Table(number, caption, ("gamma", *AP_COLUMNS), rows, notes)


def best_models(scores: pd.DataFrame, stages: str = "last", notes: tuple[str, ...] = ()) -> Table:
    """Table IV: for each detector the best model with gamma = 0 and the best with any gamma > 0.

    Args:
        scores: see ``selection.select``; further columns ``detector``, ``gamma`` and ``lr``, the base rate.
        stages: see ``selection.select``.
        notes: put below.
    """
    rows: list[tuple[Cell, ...]] = []
    for detector in sorted(scores["detector"].unique()):
        chosen = _one_row_each(select(scores[scores["detector"] == detector], "best", stages), "IV")
        base = _baseline(chosen)
        focal = chosen[chosen["gamma"] > 0]
        pair = [] if base is None else [base]
        if len(focal):
            pair.append(focal.iloc[int(focal[MEAN_3D].mean(axis=1).to_numpy().argmax())])
        rows += [(*_front_cells(row, detector), *_ap_cells(row, base)) for row in pair]
    columns = ("detector", "lr", "step", "gamma", *AP_COLUMNS)
    return Table("IV", "Evaluation results on the validation split for best models", columns, tuple(rows), notes)


def make_tables(scores: pd.DataFrame, stages: str = "last", notes: tuple[str, ...] = ()) -> list[Table]:
    """Tables II, III and IV, as far as there are scores for them."""
    present = set(scores["detector"])
    tables = [last_models(scores, number, notes) for number, name in LAST_TABLES.items() if name in present]
    return [*tables, best_models(scores, stages, notes)]


def _one_row_each(chosen: pd.DataFrame, number: str) -> pd.DataFrame:
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


def _baseline(chosen: pd.DataFrame) -> pd.Series | None:
    zero = chosen[chosen["gamma"] == 0]
    return zero.iloc[0] if len(zero) else None


def _ap_cells(row: pd.Series, base: pd.Series | None) -> list[Cell]:
    """Two decimals; bold where the printed number is strictly above the printed one of gamma = 0."""
    cells = []
    for metric in AP_COLUMNS.values():
        text = f"{row[metric]:.2f}"
        bold = base is not None and float(text) > float(f"{base[metric]:.2f}")
        cells.append(Cell(text, bold))
    return cells


def _front_cells(row: pd.Series, detector: str) -> list[Cell]:
    printed = "/".join(f"{int(s) / 1000:.0f}k" if int(s) >= 10_000 else s for s in row["step"].split("/"))
    lr = Cell(format_lr(float(row["lr"])), raw=f"{row['lr']:g}")
    return [
        Cell(detector),
        lr,
        Cell(printed, raw=row["step"]),
        Cell(f"{row['gamma']:g}"),
    ]


def format_lr(lr: float) -> str:
    """As the paper prints it: 0.01 -> ``1e-2``, 0.0025 -> ``2.5e-3``."""
    mantissa, exponent = f"{lr:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def to_csv(table: Table) -> str:
    """Comma-separated, plain numbers."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([c.text if c.raw is None else c.raw for c in row] for row in table.rows)
    return out.getvalue()


def to_markdown(table: Table) -> str:
    """GitHub Markdown, in the paper's column order."""
    front = _front_names(table)
    head = [*front, *(f"{view} {level}" for view in ("BEV", "3D") for level in ("Easy", "Mod", "Hard"))]
    rows = [[f"**{c.text}**" if c.bold else c.text for c in _paper_order(table, row)] for row in table.rows]
    lines = [f"**Table {table.number}.** {table.caption}. AP in percent; bold: better than γ = 0.", ""]
    lines += [_markdown_row(head), "|" + "---|" * len(front) + "---:|" * 6, *(_markdown_row(row) for row in rows)]
    if table.notes:
        lines += ["", *(f"{note}  " for note in table.notes)]
    return "\n".join(lines) + "\n"


def _markdown_row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def to_latex(table: Table) -> str:
    """A table that compiles as it is, with the package booktabs."""
    front = [{"γ": r"$\gamma$"}.get(name, name) for name in _front_names(table)]
    n = len(front)
    lines = [
        r"\begin{table}[t]",
        r"\centering",
        r"\setlength{\tabcolsep}{4pt}",
        rf"\caption{{{_latex(table.caption)}. AP in \%; bold: better than $\gamma = 0$.}}",
        rf"\begin{{tabular}}{{{'l' * n}rrrrrr}}",
        r"\toprule",
        "& " * n + r"\multicolumn{3}{c}{Bird's Eye View AP (\%)} & \multicolumn{3}{c}{3D Detection AP (\%)} \\",
        rf"\cmidrule(lr){{{n + 1}-{n + 3}}} \cmidrule(lr){{{n + 4}-{n + 6}}}",
        " & ".join([*front, *["Easy", "Mod", "Hard"] * 2]) + r" \\",
        r"\midrule",
    ]
    for row in table.rows:
        cells = [rf"\textbf{{{_latex(c.text)}}}" if c.bold else _latex(c.text) for c in _paper_order(table, row)]
        lines.append(" & ".join(cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\smallskip\footnotesize {_latex(' '.join(table.notes))}"] if table.notes else []
    return "\n".join([*lines, r"\end{table}"]) + "\n"


def _paper_order(table: Table, row: tuple[Cell, ...]) -> list[Cell]:
    """The paper prints gamma before lr and step; the CSV has it behind them."""
    if table.number != "IV":
        return list(row)
    detector, lr, step, gamma, *aps = row
    return [detector, gamma, lr, step, *aps]


def _front_names(table: Table) -> list[str]:
    return ["Detector", "γ", "lr", "Step"] if table.number == "IV" else ["γ"]


def _latex(text: str) -> str:
    for character, escaped in (("\\", r"\textbackslash{}"), ("_", r"\_"), ("%", r"\%"), ("&", r"\&"), ("#", r"\#")):
        text = text.replace(character, escaped)
    return text.replace("γ", r"$\gamma$").replace("≥", r"$\geq$").replace("×", r"$\times$")
