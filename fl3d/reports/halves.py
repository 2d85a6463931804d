"""Best beside last beside what the best is worth on frames that did not choose it. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from fl3d.reports.levels import Levels
from fl3d.reports.seeds import seeds_by, seeds_note
from fl3d.reports.table import Cell, Column, Table

LAST = 5  # checkpoints that are averaged
METRIC = "ap_3d/moderate"
HEADS = {
    "last": "last",
    "last_few": "mean of last {n}",
    "best": "best",
    "half": "best of a half, there",
    "other_half": "on the other half",
    "optimism": "optimism",
}
LEGEND = "Best by the mean of the three 3D APs; optimism: what the choosing half promises and the other does not keep"


def halves_table(
    scores: pd.DataFrame,
    last: pd.DataFrame,
    best: pd.DataFrame,
    halved: pd.DataFrame,
    levels: Levels,
    notes: tuple[str, ...] = (),
) -> Table:
    """3D AP moderate of the last and the best checkpoint, of the mean of the last few, and of split halves.

    Args:
        scores: tidy.
        last: the last checkpoint of each trial.
        best: the best of each trial's last stage.
        halved: see ``analysis.split_halves.split_halves``.
        levels: of the sweep.
        notes: put below.
    """
    inner = scores[scores["step"] > scores["first_own_step"]].sort_values("step")
    counts = inner.groupby("trial").size()
    sides = halved.set_index("trial")
    frame = last.set_index("trial")[["group", "level", METRIC]].rename(columns={METRIC: "last"})
    frame = frame.assign(
        last_few=inner.groupby("trial")[METRIC].apply(lambda own: own.tail(LAST).mean()),
        best=best.set_index("trial")[METRIC],
        half=sides["chosen"],
        other_half=sides["other"],
    )
    rows = []
    for group, own in frame.groupby("group"):
        means = own.groupby("level", sort=False)[list(HEADS)[:-1]].mean().reset_index()
        rows += [_row(str(group), row) for row in levels.sorted(means).to_dict("records")]
    fewest, most = (min(LAST, int(count)) for count in (counts.min(), counts.max()))
    n = str(most) if fewest == most else f"{fewest} to {most}"
    seeds = seeds_note(seeds_by(levels.sorted(last), ["group", "level"]))
    among = "/".join(str(count) for count in sorted(counts.unique()))
    return Table(
        "honest",
        "Last, best and honest best: 3D AP moderate (R11) of the models of each trial",
        (
            Column("group", "Group"),
            Column("level", levels.head or "level"),
            *(Column(key, head.format(n=n), "", True) for key, head in HEADS.items()),
        ),
        tuple(rows),
        LEGEND,
        (*notes, f"Best is chosen among {among} checkpoints of a trial's last stage.", seeds),
    )


def _row(group: str, row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    texts = [f"{row[key]:.2f}" for key in list(HEADS)[:-1]]
    optimism = row["half"] - row["other_half"]
    return (
        Cell(group),
        Cell(str(row["level"])),
        *(Cell(text) for text in texts),
        Cell(f"{optimism:+.2f}"),
    )
