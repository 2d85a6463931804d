"""A table beside the published one: differences, and whether gains, bold and the order over gamma agree. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from fl3d.reports.published import ARXIV, published_table
from fl3d.reports.table import AP_COLUMNS, HEADS, Cell, Column, Table

DASH = "–"


@dataclass(frozen=True)
class Agreement:
    """How far gains over the base agree, for one column.

    Args:
        signs: rows whose gain has the published gain's sign.
        bolds: rows that are bold in both or in neither.
        rows: compared.
        rank: Spearman's correlation of the APs over the rows, base included; None for less than three rows.
    """

    signs: int
    bolds: int
    rows: int
    rank: float | None


def beside(table: Table) -> Table | None:
    """Table II, III, IV or V with the journal's numbers beside ours; None for others, and where no row is published.

    Rows are matched by gamma, or by the loss; those of Table IV by detector and by whether gamma is 0, since the best
    gamma may be another.
    """
    if table.number not in ("II", "III", "IV", "V"):
        return None
    printed, arxiv = _published(table)
    keys = row_keys(table)
    kept = [i for i, key in enumerate(keys) if key in printed]
    if not kept:
        return None
    front = [c for c in table.columns if c.key not in AP_COLUMNS]
    columns = list(front)
    for key in AP_COLUMNS:
        view, level = key.split("_")
        group = f"{view.upper()} {HEADS[level]}"
        columns += [Column(f"{key}{end}", head, group, True) for end, head in ENDS.items()]
    rows = []
    for i in kept:
        row: list[Cell] = [table.column(column.key)[i] for column in front]
        for key in AP_COLUMNS:
            own, theirs = table.column(key)[i], printed[keys[i]]
            difference = float(own.text) - float(theirs[key])
            also = f" ({arxiv[keys[i]][key]})" if keys[i] in arxiv and arxiv[keys[i]][key] != theirs[key] else ""
            row += [own, Cell(theirs[key] + also, theirs[f"{key}_bold"] == "1"), Cell(f"{difference:+.2f}")]
        rows.append(tuple(row))
    agreements = [agreement(table, key) for key in AP_COLUMNS]
    for label, texts in summary(agreements).items():
        cells = [Cell(label), *[Cell("")] * (len(front) - 1)]
        for text in texts:
            cells += [Cell(text), Cell(""), Cell("")]
        rows.append(tuple(cells))
    notes = table.notes
    if any(keys[i] in arxiv for i in kept):
        notes = (*notes, "In parentheses: the first arXiv version, where it differs.")
    if table.number == "IV":
        told = [f"{r['detector']} γ = {r['gamma']}, lr {r['lr']}, step {r['step']}" for r in printed.values()]
        notes = (*notes, "The paper's rows: " + "; ".join(told) + ".")
    return Table(f"{table.name}_published", table.caption, tuple(columns), tuple(rows), LEGEND, notes)


ENDS = {"": "ours", "_published": "paper", "_difference": "diff."}
LEGEND = "AP in percent; bold: better than the first row of its kind, in ours and in the paper"


def agreement(table: Table, column: str) -> Agreement:
    """How far the gains of one column agree with the published ones."""
    printed, _ = _published(table)
    keys, cells = row_keys(table), table.column(column)
    own = {key: cell for key, cell in zip(keys, cells, strict=True) if key in printed}
    signs = bolds = rows = 0
    for key, cell in own.items():
        base = base_of(table, key)
        if base == key or base not in own:
            continue
        gain, theirs = (
            float(cell.text) - float(own[base].text),
            float(printed[key][column]) - float(printed[base][column]),
        )
        signs += (gain > 0) == (theirs > 0) and (gain < 0) == (theirs < 0)
        bolds += cell.bold == (printed[key][f"{column}_bold"] == "1")
        rows += 1
    rank = None
    if table.number in ("II", "III") and len(own) > 2:
        ours = pd.Series([float(cell.text) for cell in own.values()])
        paper = pd.Series([float(printed[key][column]) for key in own])
        rank = float(ours.rank().corr(paper.rank()))
    return Agreement(int(signs), bolds, rows, rank)


def summary(agreements: Sequence[Agreement]) -> dict[str, list[str]]:
    """Rows below the table: a label, and a text for each column."""
    found = {
        "gains of the same sign": [f"{a.signs}/{a.rows}" if a.rows else DASH for a in agreements],
        "bold alike": [f"{a.bolds}/{a.rows}" if a.rows else DASH for a in agreements],
    }
    if any(a.rank is not None for a in agreements):
        found["rank correlation ρ"] = [
            DASH if a.rank is None or pd.isna(a.rank) else f"{a.rank:+.2f}" for a in agreements
        ]
    return found


def row_keys(table: Table) -> list[str]:
    """What a row is matched by."""
    if table.number == "IV":
        pairs = zip(table.column("detector"), table.column("gamma"), strict=True)
        return [_best_key(detector.text, gamma.text) for detector, gamma in pairs]
    return [cell.text for cell in table.column("loss" if table.number == "V" else "gamma")]


def base_of(table: Table, key: str) -> str:
    """The row that a row's gain is over."""
    return {"IV": f"{key.partition(' ')[0]} base", "V": "Original"}.get(table.number, "0")


def _best_key(detector: str, gamma: str) -> str:
    return f"{detector} {'base' if float(gamma) == 0 else 'focal'}"


def _published(table: Table) -> tuple[dict[str, dict[str, str]], dict[str, dict[str, str]]]:
    """Published rows by their key, and those of the arXiv version."""
    found: list[dict[str, dict[str, str]]] = []
    for name in (table.number, ARXIV.get(table.number)):
        rows = published_table(name).to_dict("records") if name else []
        found.append({_key(table.number, row): {str(k): str(v) for k, v in row.items()} for row in rows})
    return found[0], found[1]


def _key(number: str, row: dict[object, str]) -> str:
    if number == "IV":
        return _best_key(row["detector"], row["gamma"])
    return row["loss"] if number == "V" else f"{float(row['gamma']):g}"
