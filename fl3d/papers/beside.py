"""A table beside the published one: differences, and whether gains, bold and order agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from fl3d.reports.table import AP_COLUMNS, HEADS, Cell, Column, Table

DASH = "–"
ENDS = {"": "ours", "_published": "paper", "_difference": "diff."}
LEGEND = "AP in percent; bold: better than the first row of its kind, in ours and in the paper"
Row = Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Published:
    """The published counterpart of a table.

    Args:
        rows: printed cells by what a row is matched by.
        earlier: of an earlier version of the paper, where it differs.
        base_of: the row that a row's gain is over.
        is_ordered: whether the order of the rows by AP means something.
    """

    rows: Mapping[str, Row]
    base_of: Callable[[str], str]
    earlier: Mapping[str, Row] = field(default_factory=dict)
    is_ordered: bool = False


@dataclass(frozen=True)
class Agreement:
    """How far gains over the base agree, for one column.

    Args:
        signs: rows whose gain has the published gain's sign.
        bolds: rows that are bold in both or in neither.
        rows: compared.
        rank: Spearman's correlation of the APs over the rows, base included; None where their order means nothing, or
            for less than three rows.
    """

    signs: int
    bolds: int
    rows: int
    rank: float | None


def beside(
    table: Table, keys: Sequence[str], published: Published, notes: tuple[str, ...] = ()
) -> Table | None:
    """A table with the published numbers beside ours; None where no row is published.

    Args:
        table: ours.
        keys: what each of its rows is matched by.
        published: the printed cells.
        notes: put below, behind the table's own.
    """
    kept = [number for number, key in enumerate(keys) if key in published.rows]
    if not kept:
        return None
    front = [column for column in table.columns if column.key not in AP_COLUMNS]
    rows = [_row(table, number, keys[number], front, published) for number in kept]
    agreements = [agreement(table, keys, published, key) for key in AP_COLUMNS]
    for label, texts in summary(agreements).items():
        cells = [Cell(label), *[Cell("")] * (len(front) - 1)]
        for text in texts:
            cells += [Cell(text), Cell(""), Cell("")]
        rows.append(tuple(cells))
    own_notes = table.notes
    if any(keys[number] in published.earlier for number in kept):
        own_notes = (*own_notes, "In parentheses: the first arXiv version, where it differs.")
    return table.as_view(
        "published",
        columns=(*front, *_columns()),
        rows=tuple(rows),
        legend=LEGEND,
        notes=(*own_notes, *notes),
        csv_order=(),
    )


def _columns() -> list[Column]:
    columns = []
    for key in AP_COLUMNS:
        view, difficulty = key.split("_")
        group = f"{view.upper()} {HEADS[difficulty]}"
        columns += [Column(f"{key}{end}", head, group, True) for end, head in ENDS.items()]
    return columns


def _row(
    table: Table, number: int, key: str, front: Sequence[Column], published: Published
) -> tuple[Cell, ...]:
    cells: list[Cell] = [table.column(column.key)[number] for column in front]
    theirs = published.rows[key]
    earlier = published.earlier.get(key, {})
    for column in AP_COLUMNS:
        own = table.column(column)[number]
        difference = float(own.text) - float(theirs[column])
        differs = column in earlier and earlier[column] != theirs[column]
        also = f" ({earlier[column]})" if differs else ""
        printed = Cell(theirs[column] + also, theirs[f"{column}_bold"] == "1")
        cells += [own, printed, Cell(f"{difference:+.2f}")]
    return tuple(cells)


def agreement(table: Table, keys: Sequence[str], published: Published, column: str) -> Agreement:
    """How far the gains of one column agree with the published ones."""
    cells = table.column(column)
    own = {key: cell for key, cell in zip(keys, cells, strict=True) if key in published.rows}
    signs = 0
    bolds = 0
    rows = 0
    for key, cell in own.items():
        base = published.base_of(key)
        if base == key or base not in own:
            continue
        gain = float(cell.text) - float(own[base].text)
        theirs = float(published.rows[key][column]) - float(published.rows[base][column])
        signs += (gain > 0) == (theirs > 0) and (gain < 0) == (theirs < 0)
        bolds += cell.bold == (published.rows[key][f"{column}_bold"] == "1")
        rows += 1
    rank = None
    if published.is_ordered and len(own) > 2:
        ours = pd.Series([float(cell.text) for cell in own.values()])
        paper = pd.Series([float(published.rows[key][column]) for key in own])
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
