"""A table of last models with intervals and verdicts, from what a sweep has found."""

from __future__ import annotations

from collections.abc import Callable

from fl3d.analysis.found import Judged
from fl3d.reports.intervals import with_intervals
from fl3d.reports.levels import Levels
from fl3d.reports.table import Table
from fl3d.reports.verdicts import LEGEND, seeds_text, verdict_tables, verdict_word


def intervals_by_level(
    table: Table,
    judged: Judged,
    group: str,
    bold: str,
    average: str = "R11",
    row_of: Callable[[str], str] = str,
) -> Table | None:
    """A table whose rows are the levels of one group, with intervals and verdicts; None without the baseline.

    Args:
        table: as made.
        judged: what the sweep has found.
        group: whose table it is.
        bold: what bold stands for in it.
        average: of its APs.
        row_of: text of a row's first cell, of a level.
    """
    gains = judged.gains[judged.gains["group"] == group]
    verdicts = judged.verdicts[judged.verdicts["group"] == group]
    if gains.empty:
        return None
    words = {row_of(str(row["level"])): verdict_word(row) for row in verdicts.to_dict("records")}
    named = gains.assign(row=gains["level"].map(row_of))
    view = with_intervals(table, named, bold, average=average, verdicts=words)
    metric = verdicts["metric"].iloc[0]
    meant = f"Verdict: by the gain in {metric} of the last models; {LEGEND.format(margin=judged.margin)}."
    left_out = [f"{line}." for line in judged.left_out if line.startswith(f"{group} ")]
    return view.with_notes(*view.notes, meant, seeds_text(verdicts), judged.units.note, *left_out)


def tables_of_verdicts(judged: Judged, levels: Levels) -> list[Table]:
    """The verdicts of a sweep, a table a group, with what a reader must know."""
    left_out = tuple(f"{line}." for line in judged.left_out)
    notes = (seeds_text(judged.verdicts), judged.units.note, *left_out)
    return verdict_tables(judged.verdicts, levels, judged.margin, notes)
