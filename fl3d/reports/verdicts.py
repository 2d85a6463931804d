"""Verdicts as text and as tables. Pure: rows of ``analysis.verdicts.verdicts`` in, words out."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from fl3d.core.plurals import several
from fl3d.evaluation.verdicts import FEWEST, Verdict
from fl3d.reports.levels import Levels, note_on_gains, slug
from fl3d.reports.table import Cell, Column, Table

Row = Mapping[Hashable, Any]
ONE_SEED = "frames only, not training"
FULL = 100 - 1e-9  # AP, but for rounding
NOTHING = "–"
ALONE = "no other level is done"
LEGEND = (
    "better, worse: the gain's interval excludes 0; equivalent: it lies within ± {margin:g} AP; undecided: neither. "
    "The gains' intervals of a table hold all at once (95 %)"
)


def verdict_text(row: Row, margin: float) -> str:
    """A verdict in words, such as ``undecided, about 4 more seeds``.

    Args:
        row: of ``analysis.verdicts.verdicts``.
        margin: of the verdicts, AP.
    """
    verdict = Verdict(row["verdict"])
    if verdict is Verdict.BASELINE:
        return "baseline"
    if row.get("copies"):
        return f"none: {row['copies']} have the same detections: does the program read its seed?"
    if verdict is Verdict.NONE and math.isnan(row["gain"]):
        return "none: no ground truth counts"
    if verdict is Verdict.NONE and row["seeds"] >= FEWEST and row["ap"] == 0:
        return "none: neither finds anything (AP 0)"
    if verdict is Verdict.NONE:
        return ONE_SEED if row["seeds"] == 1 else f"no verdict before {FEWEST} seeds{_more(row)}"
    if verdict is Verdict.EQUIVALENT:
        return f"equivalent within {margin:g} AP{_why_same(row)}"
    if verdict is Verdict.UNDECIDED:
        return f"undecided{_more(row)}"
    is_small = -margin < row["gain_low"] and row["gain_high"] < margin
    return f"{verdict}, by less than {margin:g} AP" if is_small else str(verdict)


def _why_same(row: Row) -> str:
    """What may be behind a gain of 0 in every resample; of other gains nothing."""
    if not row["gain_low"] == row["gain_high"] == 0:
        return ""
    if row["ap"] >= FULL:
        return ": both find everything (AP 100)"
    return ": the same AP in every resample, as if nothing read what it changes"


def verdict_word(row: Row) -> str:
    """A verdict in a word or two, for a column of a wide table."""
    verdict = Verdict(row["verdict"])
    if verdict is Verdict.NONE:
        if row.get("copies"):
            return "copies"
        if math.isnan(row["gain"]):
            return "no objects"
        if row["seeds"] >= FEWEST and row["ap"] == 0:
            return "AP 0"
        return "frames only" if row["seeds"] == 1 else "too few seeds"
    return str(verdict)


def _more(row: Row) -> str:
    if math.isnan(row["more_seeds"]):
        return "; seeds alone would probably not tell, more frames or a wider margin might"
    count = int(row["more_seeds"])
    seeds = f", about {several(count, 'more seed')}"
    minutes = row.get("seed_minutes", math.nan)
    return seeds if math.isnan(minutes) else f"{seeds}, {_time(count * minutes)} of work"


def _time(minutes: float) -> str:
    if minutes < 1:
        return "less than a minute"
    return f"{minutes:.0f} minutes" if minutes < 100 else f"{minutes / 60:.0f} hours"


def gain_text(row: Row, digits: int = 2) -> str:
    """A gain and its interval: ``+0.45 [-0.31, +1.20]``; a dash where it is not known."""
    if math.isnan(row["gain"]):
        return NOTHING
    ends = f"[{row['gain_low']:+.{digits}f}, {row['gain_high']:+.{digits}f}]"
    return f"{row['gain']:+.{digits}f} {ends}"


def ap_text(row: Row, digits: int) -> str:
    """An AP and its interval, whose ends have so many digits; a dash where no ground truth counts."""
    if math.isnan(row["ap"]):
        return NOTHING
    return f"{row['ap']:.2f} [{row['ap_low']:.{digits}f}, {row['ap_high']:.{digits}f}]"


def verdict_tables(
    verdicts: pd.DataFrame, levels: Levels, margin: float, notes: tuple[str, ...] = ()
) -> list[Table]:
    """Each level's AP, gain and verdict, a table a group.

    Args:
        verdicts: see ``analysis.verdicts.verdicts``.
        levels: of the sweep.
        margin: of the verdicts, AP.
        notes: put below.
    """
    columns = (
        Column("level", levels.head or "level"),
        Column("seeds", "seeds", "", True),
        Column("ap", "AP"),
        Column("gain", f"gain over {levels.text(levels.baseline)}"),
        Column("verdict", "verdict"),
    )
    tables = []
    for group, own in verdicts.groupby("group"):
        rows = tuple(_row(row, margin) for row in levels.sorted(own).to_dict("records"))
        caption = f"Verdicts on {group}, {own['metric'].iloc[0]}, last models"
        name = f"verdicts-{slug(str(group))}"
        told = (*notes, *note_on_gains(own, levels))
        tables.append(Table(name, caption, columns, rows, LEGEND.format(margin=margin), told))
    return tables


def _row(row: Row, margin: float) -> tuple[Cell, ...]:
    ap = ap_text(row, 2)
    gain = "" if row["verdict"] == Verdict.BASELINE else gain_text(row)
    is_final = Verdict(row["verdict"]).is_final
    word = Cell(verdict_text(row, margin), bold=is_final)
    return Cell(str(row["level"])), Cell(str(row["seeds"])), Cell(ap), Cell(gain), word


def in_short(verdicts: pd.DataFrame, levels: Levels) -> str:
    """What was found, on one line: levels with a verdict by name, the others by their number.

    Args:
        verdicts: see ``analysis.verdicts.verdicts``.
        levels: of the sweep.
    """
    found = []
    for group, own in verdicts.groupby("group"):
        others = levels.sorted(own[own["verdict"] != Verdict.BASELINE])
        named: dict[Verdict, list[Row]] = {verdict: [] for verdict in Verdict}
        for row in others.to_dict("records"):
            named[Verdict(row["verdict"])].append(row)
        parts = [_count(verdict, of, levels) for verdict, of in named.items() if of]
        found.append(f"{group}: {', '.join(parts) or ALONE}.")
    return " ".join(found)


def findings(verdicts: pd.DataFrame, levels: Levels, margin: float) -> list[str]:
    """What was found, a sentence for each group: verdicts with their gains, and what is next to be decided.

    Args:
        verdicts: see ``analysis.verdicts.verdicts``.
        levels: of the sweep.
        margin: of the verdicts, AP.
    """
    found = []
    for group, own in verdicts.groupby("group"):
        rows = levels.sorted(own[own["verdict"] != Verdict.BASELINE]).to_dict("records")
        parts = [
            f"{levels.text(str(row['level']))} is {verdict_text(row, margin)} ({gain_text(row, 1)} AP)"
            for row in rows
            if Verdict(row["verdict"]).is_final
        ]
        parts += _open(rows, levels, margin)
        base = f"{levels.text(levels.baseline)}, {own['metric'].iloc[0]}"
        found.append(f"{group}, against {base}: {'; '.join(parts) or ALONE}.")
    return found


def _open(rows: Sequence[Row], levels: Levels, margin: float) -> list[str]:
    """Levels without a verdict: how many, and the one that would need the fewest seeds."""
    parts = []
    undecided = [row for row in rows if row["verdict"] == Verdict.UNDECIDED]
    known = [row for row in undecided if not math.isnan(row["more_seeds"])]
    if undecided:
        more = ""
        if known:
            next_one = min(known, key=lambda row: float(row["more_seeds"]))
            words = verdict_text(next_one, margin).partition(", ")[2]
            level = f"{levels.text(str(next_one['level']))} ({gain_text(next_one, 1)} AP)"
            is_alone = len(undecided) == 1
            more = f": {level}" if is_alone else f", of which {level} needs the fewest seeds"
            more += f", {words}"
        parts.append(f"{len(undecided)} undecided{more}")
    silent = [row for row in rows if row["verdict"] == Verdict.NONE]
    if silent:
        parts.append(f"{len(silent)} without a verdict{_why_copied(silent, levels)}")
    return parts


def _why_copied(rows: Sequence[Row], levels: Levels) -> str:
    """Levels that have no verdict since their seeds are copies: `` (γ = 2: seeds 0, 1 have the same detections)``."""
    told = [
        f"{levels.text(str(row['level']))}: {row['copies']} have the same detections"
        for row in rows
        if row.get("copies")
    ]
    return f" ({'; '.join(told)})" if told else ""


def _count(verdict: Verdict, rows: Sequence[Row], levels: Levels) -> str:
    if verdict is Verdict.NONE:
        return f"{len(rows)} without a verdict{_why_copied(rows, levels)}"
    if verdict.is_final:
        return f"{levels.text(', '.join(str(row['level']) for row in rows))} {verdict}"
    return f"{len(rows)} {verdict}"


def seeds_text(verdicts: pd.DataFrame) -> str:
    """Over what the intervals reach: frames alone, or so many seeds of training too."""
    counts = sorted({int(count) for count in verdicts["seeds"]})
    if counts == [1]:
        return "Intervals over frames only, not training: one seed says nothing about another."
    shown = " / ".join(str(count) for count in counts)
    return f"Intervals over frames and {shown} seeds of training."
