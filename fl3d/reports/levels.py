"""Tables of any sweep: a row a level, a table a group. Pure: frames in, tables out.

Frames have the columns ``group`` and ``level``, as ``runs.scores`` and ``analysis`` make them.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from fl3d.core.digests import digest
from fl3d.reports.seeds import PAIRED, better_in_pairs, gains_note, seeds_by, seeds_note
from fl3d.reports.table import HEADS, Cell, Column, Table

SYMBOLS = {"alpha": "α", "beta": "β", "eta": "η", "gamma": "γ"}  # as the papers write them
VIEWS = ("bev", "3d")
DIFFICULTIES = ("easy", "moderate", "hard")
LONGEST_SLUG = 100  # bytes: file names end at 255, and a sweep's name and an ending stand beside it


@dataclass(frozen=True)
class Levels:
    """The levels of a sweep, as tables and figures tell them.

    Args:
        name: of the factor, short: ``gamma``, or ``alpha, beta``.
        labels: in the order in which they are shown.
        baseline: label of the level that the others are held against.
    """

    name: str
    labels: Sequence[str]
    baseline: str

    @property
    def head(self) -> str:
        """Of a column of levels."""
        return ", ".join(SYMBOLS.get(part, part) for part in self.name.split(", "))

    def text(self, level: str) -> str:
        """A level beside other words: ``γ = 0.5``."""
        return f"{self.head} = {level}" if self.name and ", " not in self.name else level

    def sorted(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Rows of a frame by level."""
        place = {label: number for number, label in enumerate(self.labels)}
        return frame.sort_values("level", key=lambda column: column.map(place), kind="stable")


def ap_columns(average: str) -> dict[str, str]:
    """Metrics of a table's AP columns, by the columns' keys: ``3d_easy`` -> ``ap_3d_r40/easy``."""
    end = "_r40" if average == "R40" else ""
    return {
        f"{view}_{level}": f"ap_{view}{end}/{level}" for view in VIEWS for level in DIFFICULTIES
    }


def levels_table(
    last: pd.DataFrame,
    group: str,
    levels: Levels,
    name: str,
    average: str,
    notes: tuple[str, ...] = (),
) -> Table:
    """Last models of one group by level; trials that differ in their seed alone are averaged.

    Args:
        last: the last checkpoint of each trial.
        group: whose rows are shown.
        levels: of the sweep.
        name: of the table: files are called after it.
        average: ``R11`` or ``R40``.
        notes: put below.
    """
    metrics = ap_columns(average)
    own = last[last["group"] == group]
    means = levels.sorted(
        own.groupby("level", sort=False)[list(metrics.values())].mean().reset_index()
    )
    counts = own.groupby("level").size()
    base = own[own["level"] == levels.baseline]
    rows = []
    for _, row in means.iterrows():
        better = better_in_pairs(own[own["level"] == row["level"]], base, metrics.values())
        cells = [Cell(str(row["level"])), Cell(str(counts[row["level"]]))]
        for metric, bold in zip(metrics.values(), better, strict=True):
            cells.append(Cell(f"{row[metric]:.2f}", bold=bold))
        rows.append(tuple(cells))
    views = tuple(
        Column(key, HEADS[key.partition("_")[2]], key.partition("_")[0].upper(), True)
        for key in metrics
    )
    columns = (Column("level", levels.head or "level"), Column("seeds", "seeds", "", True), *views)
    legend = f"AP in percent ({average}); bold: better than {levels.text(levels.baseline)}"
    note = seeds_note(seeds_by(levels.sorted(own), ["level"]), PAIRED)
    return Table(name, f"Last models of {group}", columns, tuple(rows), legend, (*notes, note))


def gains_tables(gains: pd.DataFrame, levels: Levels, metric: str, average: str) -> list[Table]:
    """AP and gain of one metric, a table a group; a star marks gains, see ``analysis.gains.gains``.

    Args:
        gains: see ``analysis.gains.gains``.
        levels: of the sweep.
        metric: such as ``3d/moderate``.
        average: ``R11`` or ``R40``.
    """
    view, difficulty = metric.split("/")
    chosen = gains[
        (gains["metric"] == view)
        & (gains["difficulty"] == difficulty)
        & (gains["average"] == average)
    ]
    columns = (
        Column("level", levels.head or "level"),
        Column("seeds", "seeds", "", True),
        Column("ap", "AP"),
        Column("gain", f"gain over {levels.text(levels.baseline)}"),
        Column("mark", ""),
    )
    star = (
        "; *: the gain in R40 differs from zero where all BEV and 3D gains are looked at together"
    )
    tables = []
    for group, own in chosen.groupby("group"):
        rows = tuple(
            _gain_row(row, levels.baseline) for row in levels.sorted(own).to_dict("records")
        )
        caption = f"{group}, {view} {difficulty}, {average}, last models, 95 % intervals"
        legend = "Each interval by itself" + (star if own["marked"].any() else "")
        notes = note_on_gains(own, levels)
        tables.append(Table(f"gains-{slug(str(group))}", caption, columns, rows, legend, notes))
    return tables


def note_on_gains(own: pd.DataFrame, levels: Levels) -> tuple[str, ...]:
    """See ``reports.seeds.gains_note``.

    Args:
        own: rows of one group with ``level`` and ``seeds``, one a level.
        levels: of the sweep.
    """
    is_base = own["level"] == levels.baseline
    others = levels.sorted(own[~is_base])
    if "copies" in others:  # the first of them counts, and this is said where the seeds are
        others = others[[not one or pd.isna(one) for one in others["copies"]]]
    names = [levels.text(str(level)) for level in others["level"]]
    shared = dict(zip(names, others["seeds"].astype(int), strict=True))
    return gains_note(shared, int(own[is_base]["seeds"].max())) if is_base.any() else ()


def _gain_row(row: Mapping[Hashable, Any], baseline: str) -> tuple[Cell, ...]:
    ap = f"{row['ap']:.2f} [{row['ap_low']:.2f}, {row['ap_high']:.2f}]"
    gain = f"{row['gain']:+.2f} [{row['gain_low']:+.2f}, {row['gain_high']:+.2f}]"
    star = "*" if row["marked"] else ""
    step = "one R11 step" if row["one_r11_step"] else ""
    shown = gain if row["level"] != baseline else "baseline"
    marks = f"{star} {step}".strip()
    return Cell(str(row["level"])), Cell(str(row["seeds"])), Cell(ap), Cell(shown), Cell(marks)


def rescored_tables(
    scores: pd.DataFrame, levels: Levels, changes: Sequence[str], metric: str
) -> list[Table]:
    """AP by level (rows) and changed protocol values (columns), a table a group; seeds are averaged.

    Args:
        scores: see ``analysis.rescore.rescore``.
        levels: of the sweep.
        changes: keys of the protocol that were changed.
        metric: column of the AP.
    """
    tables = []
    for group, own in scores.groupby("group"):
        wide = own.pivot_table(
            index="level", columns=list(changes), values=metric, aggfunc="mean", sort=False
        )
        wide = levels.sorted(wide.reset_index()).set_index("level")
        heads = [", ".join(head) if isinstance(head, tuple) else str(head) for head in wide.columns]
        columns = (
            Column("level", levels.head or "level"),
            *(Column(f"value_{number}", head, "", True) for number, head in enumerate(heads)),
        )
        rows = []
        for level, aps in zip(wide.index, wide.to_numpy(), strict=True):
            rows.append((Cell(str(level)), *(Cell(f"{ap:.2f}") for ap in aps)))
        caption = f"{group}, {metric}, last models; columns: {', '.join(changes)}"
        name = f"rescored-{slug(str(group))}"
        note = seeds_note(seeds_by(levels.sorted(own), ["level"]))
        tables.append(Table(name, caption, columns, tuple(rows), notes=(note,)))
    return tables


def slug(text: str) -> str:
    """A label as part of a file name; -1 is told from 1, and long ones are cut where they would make no file's name."""
    signed = re.sub(r"(?<![a-z0-9])-(?=[.\d])", "minus", text.lower())
    kept = "".join(letter if letter.isalnum() else "-" for letter in signed)
    whole = "-".join(part for part in kept.split("-") if part)
    if len(whole.encode()) <= LONGEST_SLUG:
        return whole
    short = whole.encode()[:LONGEST_SLUG].decode(errors="ignore")
    return f"{short}-{digest(text)[:8]}"
