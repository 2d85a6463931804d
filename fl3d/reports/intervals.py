"""A table with an interval in each cell, a star where a gain differs from zero, and a verdict behind each row. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from fl3d.reports.table import Cell, Column, Table, is_better

LEGEND = "AP in percent [95 % interval]; bold: {bold}"
STAR = (
    "star: the gain in R40 differs from zero where all gains of this table are looked at together "
    "(95 %, from three seeds on)"
)
SHARED = "Here APs are, as their intervals, of the seeds that the baseline has too"
DAGGER = (
    "†: R11 moves more than twice as far as R40, or the other way: it may be one of its recall steps, worth up to "
    "9.09 AP."
)


def with_intervals(
    table: Table,
    gains: pd.DataFrame,
    bold: str,
    key_columns: int = 1,
    average: str = "R11",
    verdicts: Mapping[str, str] | None = None,
) -> Table:
    """A table of APs with how sure each cell is.

    Args:
        table: its AP columns are named as ``reports.levels.ap_columns``.
        gains: see ``analysis.gains.gains``; a column ``row`` holds, for each row of the table, the text of its first
            columns, joined by a space. Cells show its APs, and a column of seeds their number: of the seeds that the
            interval is over, which the baseline has too.
        bold: what bold stands for in the table.
        key_columns: how many first columns tell the rows apart.
        average: of the table's APs.
        verdicts: a word for each row, by the same text; None: the table has no verdicts, and marks nothing.
    """
    chosen = gains[gains["average"] == average]
    found = {
        f"{row['row']} {row['metric']}_{row['difficulty']}": row
        for row in chosen.to_dict("records")
    }
    shared = {str(row["row"]): row for row in found.values() if row["seeds"] < row["seeds_done"]}
    marks = verdicts is not None
    rows = []
    shown = []
    for cells in table.rows:
        key = " ".join(cell.text for cell in cells[:key_columns])
        own = []
        for column, cell in zip(table.columns, cells, strict=True):
            row = found.get(f"{key} {column.key}")
            own.append(cell if row is None else _cell(cell, row, marks))
            shown += [] if row is None else [row]
        own = _of_shared_seeds(table, own, shared[key]) if key in shared else own
        rows.append((*own, *([Cell(verdicts.get(key, ""))] if verdicts is not None else [])))
    columns = (*table.columns, *([Column("verdict", "verdict")] if marks else []))
    is_stepped = any(row["one_r11_step"] for row in shown)
    is_marked = marks and any(row["marked"] for row in shown)
    legend = "; ".join([LEGEND.format(bold=bold), *([STAR] if is_marked else [])])
    told = {str(row["row"]) for row in shown} & set(shared)
    counts = [f"{key}: {_shared_text(shared[key])}" for key in sorted(told)]
    notes = (
        *table.notes,
        *((f"{SHARED} ({'; '.join(counts)}).",) if counts else ()),
        *((DAGGER,) if is_stepped else ()),
    )
    return table.as_view(
        "intervals", columns=columns, rows=tuple(rows), legend=legend, notes=notes, csv_order=()
    )


def _shared_text(row: Mapping[Hashable, Any]) -> str:
    """``3 of 5``; of seeds with the same detections the first alone counts."""
    copied = ", copies counted once" if row.get("copies") else ""
    return f"{row['seeds']} of {row['seeds_done']}{copied}"


def _of_shared_seeds(table: Table, cells: list[Cell], row: Mapping[Hashable, Any]) -> list[Cell]:
    """A row whose column of seeds, where the table has one, says how many the interval is over."""
    pairs = zip(table.columns, cells, strict=True)
    return [Cell(str(row["seeds"])) if column.key == "seeds" else cell for column, cell in pairs]


def _cell(cell: Cell, row: Mapping[Hashable, Any], marks: bool) -> Cell:
    mark = " †" if row["one_r11_step"] else ""
    text = f"{row['ap']:.2f} [{row['ap_low']:.1f}, {row['ap_high']:.1f}]{mark}"
    bold = is_better(row["ap"], row["ap"] - row["gain"]) if marks else cell.bold
    return Cell(text, bold, star=marks and bool(row["marked"]))
