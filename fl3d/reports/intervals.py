"""A table with an interval in each cell, and a star where a gain is significant. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from fl3d.reports.table import Cell, Table

LEGEND = (
    "AP in percent [95 % interval]; bold: {bold}; star: the paired gain's interval excludes zero"
)
DAGGER = "†: R11 moves more than twice as far as R40: it may be one of its recall steps, worth up to 9.09 AP."


def with_intervals(
    table: Table, gains: pd.DataFrame, bold: str, key_columns: int = 1, average: str = "R11"
) -> Table:
    """A table of APs with how sure each cell is.

    Args:
        table: its AP columns are named as ``reports.levels.ap_columns``.
        gains: see ``analysis.gains.gains``; a column ``row`` holds, for each row of the table, the text of its first
            columns, joined by a space.
        bold: what bold stands for in the table.
        key_columns: how many first columns tell the rows apart.
        average: of the table's APs.
    """
    chosen = gains[gains["average"] == average]
    found = {
        f"{row['row']} {row['metric']}_{row['difficulty']}": row
        for row in chosen.to_dict("records")
    }
    rows = []
    is_stepped = False
    for cells in table.rows:
        key = " ".join(cell.text for cell in cells[:key_columns])
        own = []
        for column, cell in zip(table.columns, cells, strict=True):
            row = found.get(f"{key} {column.key}")
            own.append(cell if row is None else _cell(cell, row))
            is_stepped |= row is not None and bool(row["one_r11_step"])
        rows.append(tuple(own))
    seeds = sorted(gains["seeds"].unique())
    over = "frames" if seeds == [1] else f"frames and {'/'.join(str(n) for n in seeds)} seeds"
    notes = (*table.notes, f"Intervals over {over}.", *((DAGGER,) if is_stepped else ()))
    return table.as_view(
        "intervals", rows=tuple(rows), legend=LEGEND.format(bold=bold), notes=notes, csv_order=()
    )


def _cell(cell: Cell, row: Mapping[Hashable, Any]) -> Cell:
    mark = " †" if row["one_r11_step"] else ""
    text = f"{cell.text} [{row['ap_low']:.1f}, {row['ap_high']:.1f}]{mark}"
    return Cell(text, cell.bold, star=bool(row["significant"]))
