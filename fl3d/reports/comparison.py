"""Tables of a comparison of detectors, whoever trained them. Pure: rows of ``analysis.compare`` in, tables out."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from fl3d.evaluation.verdicts import FEWEST, Verdict
from fl3d.reports.intervals import DAGGER
from fl3d.reports.levels import DIFFICULTIES, slug
from fl3d.reports.table import HEADS, Cell, Column, Table, is_better
from fl3d.reports.verdicts import NOTHING, ap_text, gain_text, verdict_text

VIEWS = {"3d": "3D", "bev": "BEV", "image": "2D"}  # in the order of the tables
AT_ONCE = "Intervals of gains: 95 %, for all detectors of a row at once"
STAR = "Star: differs from zero where all gains of the table are looked at together, from three runs on"
VERDICTS = (
    "Better, worse: it excludes 0; equivalent: it lies within ± {margin:g} AP; undecided: neither"
)
ONE_RUN = (
    "One run of each says what these two would do on other such {units}, not what another training of them would: "
    "no verdict and no star. Three runs make one: NAME=RUN1,RUN2,RUN3."
)
Row = Mapping[Hashable, Any]
Key = tuple[str, str, str]


@dataclass(frozen=True)
class Shown:
    """Whom the tables show.

    Args:
        names: of the detectors, in order.
        baseline: the one that the others are held against.
        margin: of the verdicts, AP.
        notes: put below.
    """

    names: Sequence[str]
    baseline: str
    margin: float
    notes: tuple[str, ...] = ()


def verdict_table(verdicts: pd.DataFrame, class_name: str, shown: Shown) -> Table:
    """Each detector's AP, gain and verdict on a class, in the primary metric.

    Args:
        verdicts: see ``analysis.compare.Compared``.
        class_name: one of its classes.
        shown: whom.
    """
    columns = (
        Column("detector", "detector"),
        Column("runs", "runs", "", True),
        Column("ap", "AP"),
        Column("gain", "gain"),
        Column("verdict", "verdict"),
    )
    own = verdicts[verdicts["group"] == class_name].to_dict("records")
    metric = metric_text(str(own[0]["metric"]))
    by_name = {str(row["level"]): _verdict_row(row, shown.margin) for row in own}
    rows = [by_name.get(name) or _without_boxes(name, metric) for name in shown.names]
    caption = f"{class_name}, {metric}: each detector against {shown.baseline}"
    has_verdict = any(row["seeds"] >= FEWEST for row in own)
    legend = AT_ONCE + (f". {VERDICTS.format(margin=shown.margin)}" if has_verdict else "")
    told = [(row["level"], _word(row, shown.margin)) for row in own]
    more = [f"{name}: {word}." for name, word in told if word != _short(word)]
    name = f"{slug(class_name)}-verdicts"
    return Table(name, caption, columns, tuple(rows), legend, (*more, *shown.notes))


def metric_text(name: str) -> str:
    """``3d_r40/moderate`` as people say it: 3D moderate, R40."""
    view, _, difficulty = name.partition("_r40/")
    return f"{VIEWS[view]} {difficulty}, R40"


def _verdict_row(row: Row, margin: float) -> tuple[Cell, ...]:
    is_base = row["verdict"] == Verdict.BASELINE
    ends = f"[{row['gain_low']:+.1f}, {row['gain_high']:+.1f}]"
    gain = NOTHING if np.isnan(row["gain"]) else f"{row['gain']:+.2f} {ends}"
    return (
        Cell(str(row["level"])),
        Cell(str(row["seeds"])),
        Cell(ap_text(row, 1)),
        Cell("" if is_base else gain),
        Cell(_short(_word(row, margin)), bold=Verdict(row["verdict"]).is_final),
    )


def _without_boxes(name: str, metric: str) -> tuple[Cell, ...]:
    view = metric.partition(" ")[0]
    return Cell(name), *(Cell(NOTHING) for _ in range(3)), Cell(f"no {view} boxes")


def _word(row: Row, margin: float) -> str:
    if row.get("copies") and row["verdict"] != Verdict.BASELINE:
        copies = str(row["copies"]).replace("seed", "run")
        return f"no verdict: {copies} have the same detections, and count as one"
    if np.isnan(row["ap"]) and row["verdict"] != Verdict.BASELINE:
        return "no verdict: no ground truth counts"
    return verdict_text(row, margin).replace("seed", "run")


def _short(word: str) -> str:
    """A verdict without what would bring one."""
    return word.partition(";")[0].partition(", about")[0].partition(":")[0]


def ap_table(cells: pd.DataFrame, class_name: str, average: str, shown: Shown) -> Table:
    """APs of a class as papers print them: a row a detector, three difficulties of each view.

    Args:
        cells: see ``analysis.compare.Compared``.
        class_name: one of its classes.
        average: ``R11`` or ``R40``.
        shown: whom.
    """
    own = _of(cells, class_name, average)
    having = {key[1] for key, row in own.items() if not np.isnan(row["ap"])}
    views = [view for view in VIEWS if view in having]
    places = [(view, level) for view in views for level in DIFFICULTIES]
    columns = (
        Column("detector", "detector"),
        *(Column(f"{v}_{level}", HEADS[level], VIEWS[v], True) for v, level in places),
    )
    rows = []
    for name in shown.names:
        line = [Cell(name)]
        for place in places:
            row = own[(name, *place)]
            bold = is_better(row["ap"], row["ap"] - row["gain"])
            text = NOTHING if np.isnan(row["ap"]) else f"{row['ap']:.2f}"
            line.append(Cell(text, bold, star=bool(row["marked"])))
        rows.append(tuple(line))
    counts = " / ".join(str(own[shown.baseline, views[0], d]["n_gt"]) for d in DIFFICULTIES)
    caption = f"{class_name}, AP in percent ({average}); ground truths: {counts}"
    has_star = any(row["marked"] for row in own.values())
    marks = [f"Bold: better than {shown.baseline}", *([STAR] if has_star else [])]
    name = f"{slug(class_name)}-{average.lower()}"
    return Table(name, caption, columns, tuple(rows), ". ".join(marks))


def gain_table(cells: pd.DataFrame, class_name: str, shown: Shown, narrow: bool = False) -> Table:
    """AP and gain of every cell of a class, with intervals: a row a cell and detector.

    Args:
        cells: see ``analysis.compare.Compared``.
        class_name: one of its classes.
        shown: whom.
        narrow: without gains in R11, for a terminal.
    """
    own = {average: _of(cells, class_name, average) for average in ("R40", "R11")}
    columns = [
        *(Column("cell", ""), Column("n_gt", "objects", "", True), Column("detector", "detector")),
        *(Column("r40", "R40", "", True), Column("r40_gain", "gain in R40")),
        Column("r11", "R11", "", True),
        *([] if narrow else [Column("r11_gain", "gain in R11")]),
    ]
    rows = []
    for place in ((view, level) for view in VIEWS for level in DIFFICULTIES):
        having = [n for n in shown.names if _has_ap(own["R40"], (n, *place))]
        for number, name in enumerate(having):
            r40, r11 = (own[average][(name, *place)] for average in ("R40", "R11"))
            front = (f"{VIEWS[place[0]]} {place[1]}", str(r40["n_gt"])) if number == 0 else ("", "")
            line = [Cell(front[0]), Cell(front[1]), Cell(name), Cell(f"{r40['ap']:.2f}")]
            line += [_gain(r40, name, shown), Cell(f"{r11['ap']:.2f}")]
            rows.append(tuple(line if narrow else [*line, _gain(r11, name, shown)]))
    caption = f"{class_name}: AP, and gain over {shown.baseline}"
    has_star = any(row["marked"] for row in own["R40"].values())
    legend = ". ".join([AT_ONCE, *([STAR] if has_star else [])])
    is_stepped = any(row["one_r11_step"] for row in own["R11"].values())
    notes = (DAGGER,) if is_stepped and not narrow else ()
    return Table(f"{slug(class_name)}-gains", caption, tuple(columns), tuple(rows), legend, notes)


def _gain(row: Row, name: str, shown: Shown) -> Cell:
    if name == shown.baseline:
        return Cell("baseline")
    if np.isnan(row["gain"]):
        return Cell(NOTHING)
    step = " †" if row["one_r11_step"] else ""
    return Cell(gain_text(row) + step, star=bool(row["marked"]))


def _of(cells: pd.DataFrame, class_name: str, average: str) -> dict[Key, Row]:
    """Rows of a class and average, by detector, metric and difficulty."""
    own = cells[(cells["class"] == class_name) & (cells["average"] == average)]
    rows = own.to_dict("records")
    return {(str(r["detector"]), str(r["metric"]), str(r["difficulty"])): r for r in rows}


def _has_ap(rows: Mapping[Key, Row], key: Key) -> bool:
    return key in rows and not np.isnan(rows[key]["ap"])
