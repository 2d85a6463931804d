"""A table with an interval in each cell, and a star where a gain is sure. Pure."""

from __future__ import annotations

import pandas as pd

from fl3d.reports.table import AP_COLUMNS, Cell, Table

LEGEND = "AP in percent [95 % interval]; bold: better than γ = 0; star: the paired gain's interval excludes zero"
DAGGER = "†: R11 moves more than twice as far as R40: it may be one of its recall steps, worth up to 9.09 AP."
SELECTED = "The intervals do not cover the choice of checkpoint and γ on the same frames."


def with_intervals(table: Table, gains: pd.DataFrame) -> Table:
    """Table II to V with how sure each cell is.

    Args:
        table: of the paper; bold as there.
        gains: see ``gains.gains``; a column ``row`` holds the text of the table's first column for each of its rows (of
            Table IV: ``DETECTOR GAMMA``).
    """
    r11 = gains[gains["average"] == "R11"]
    found = {(row["row"], row["metric"], row["difficulty"]): row for row in r11.to_dict("records")}
    rows, stepped = [], False
    places = {column.key: i for i, column in enumerate(table.columns)}
    for cells in table.rows:
        key = f"{cells[0].text} {cells[1].text}" if table.number == "IV" else cells[0].text
        own = list(cells)
        for name in AP_COLUMNS:
            view, level = name.split("_")
            sure = found.get((key, view, level))
            if sure is None:
                continue
            mark = " †" if sure["one_r11_step"] else ""
            stepped |= bool(mark)
            text = f"{cells[places[name]].text} [{sure['ap_low']:.1f}, {sure['ap_high']:.1f}]{mark}"
            own[places[name]] = Cell(text, cells[places[name]].bold, star=bool(sure["sure"]))
        rows.append(tuple(own))
    seeds = sorted(gains["seeds"].unique())
    over = "frames" if seeds == [1] else f"frames and {'/'.join(str(n) for n in seeds)} seeds"
    legend = LEGEND.replace("better than γ = 0", "the better one") if table.number == "V" else LEGEND
    notes = (*table.notes, f"Intervals over {over}.", *((DAGGER,) if stepped else ()))
    notes = (*notes, SELECTED) if table.number == "IV" else notes
    return Table(f"{table.name}_intervals", table.caption, table.columns, tuple(rows), legend, notes)
