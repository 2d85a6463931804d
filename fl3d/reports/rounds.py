"""What a sweep that adds seeds says between its rounds. Pure: rows of verdicts in, lines out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import pandas as pd

from fl3d.core.plurals import several
from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.verdicts import Row, gain_text, verdict_text

Place = tuple[str, str]  # group and level
Tell = Callable[[str], str]  # a level beside other words
STATES = ("decided", "open", "given up")


def round_text(
    found: pd.DataFrame, places: Sequence[Place], tell: Tell, margin: float, most: int
) -> str:
    """What is decided, open or given up, a line a level.

    Args:
        found: see ``analysis.verdicts.verdicts``.
        places: groups and levels of the sweep, in order.
        tell: writes a level.
        margin: of the verdicts, AP.
        most: seeds at most.
    """
    rows = rows_by_place(found)
    lines = []
    for group, level in places:
        row = rows.get((group, level))
        if row is None:
            lost = "no replicate of it is done together with the baseline's"
            lines.append(["given up", group, tell(level), "", "", lost])
        elif row["verdict"] != Verdict.BASELINE:
            state = "open" if row["open"] else "given up"
            state = "decided" if Verdict(row["verdict"]).is_final else state
            count = several(int(row["seeds"]), "seed")
            words = _words(row, margin, most)
            lines.append([state, group, tell(level), count, gain_text(row), words])
    lines.sort(key=lambda line: STATES.index(line[0]))  # the order is kept within
    return "\n".join(["", *_aligned(lines)])


def _words(row: Row, margin: float, most: int) -> str:
    if row["verdict"] == Verdict.UNDECIDED and not row["open"]:
        return f"undecided: the frames are too few for up to {most} seeds to tell"
    return verdict_text(row, margin)


def _aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [
        "  "
        + "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]


def rows_by_place(found: pd.DataFrame) -> dict[Place, Row]:
    """Rows by group and level."""
    return {(str(row["group"]), str(row["level"])): row for row in found.to_dict("records")}


def decided(found: pd.DataFrame, places: Collection[Place]) -> str:
    """How many levels have a verdict: ``5 of 12 levels have a verdict``."""
    verdicts = [Verdict(row["verdict"]) for row in found.to_dict("records")]
    count = sum(verdict.is_final for verdict in verdicts)
    groups = len({group for group, _ in places})
    return f"{count} of {len(places) - groups} levels have a verdict"


def listed(counts: Sequence[int]) -> str:
    """Numbers as people list them: ``3, 4, 5 and 10``; many are shortened."""
    shown = [str(count) for count in counts]
    if len(shown) > 4:
        shown = [*shown[:2], "...", shown[-1]]
        return ", ".join(shown)
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def time_text(seconds: float) -> str:
    """A time as people tell it: ``40 s``, ``25 minutes``, ``3.2 hours``."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 6000 else f"{seconds / 3600:.1f} hours"
