"""A forest plot: every level's gain with its interval and verdict, against zero and the margin."""

from __future__ import annotations

import textwrap
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.figures.style import Drawn, panels
from fl3d.reports.levels import Levels
from fl3d.reports.verdicts import gain_text

# Colours that colour-blind readers tell apart (Okabe and Ito 2008); in grey the markers tell them.
LOOKS = {
    Verdict.BETTER: ("#0072b2", "^", True),
    Verdict.WORSE: ("#d55e00", "v", True),
    Verdict.EQUIVALENT: ("#009e73", "s", True),
    Verdict.UNDECIDED: ("0.35", "o", False),
    Verdict.NONE: ("0.6", "x", False),
}
WORDS = {Verdict.NONE: "no verdict"}
ROW, LINE = 0.33, 0.13  # inches that a level takes, and that each line of its name does
NAME_LETTERS = 20  # of a level's name on a line: a third of a column's width
LABEL_LETTERS = 40  # of what stands below a panel, where names take a third of it
HALO = withStroke(linewidth=1.5, foreground="white")  # around numbers that lie on the line at 0


def forest(verdicts: pd.DataFrame, levels: Levels, margin: float) -> Drawn | None:
    """Gains of the last models over the baseline, a panel a group, a row a level.

    Args:
        verdicts: see ``analysis.verdicts.verdicts``.
        levels: of the sweep.
        margin: of the verdicts, AP; shown as a band.

    Returns:
        None where no level is held against the baseline, or no ground truth counts.
    """
    data = verdicts[(verdicts["verdict"] != Verdict.BASELINE) & verdicts["gain"].notna()]
    groups = sorted(data["group"].unique())
    if not groups:
        return None
    metric = str(data["metric"].iloc[0])
    reach = 1.08 * max(margin, data[["gain_low", "gain_high"]].abs().to_numpy().max())
    tallest = max(int((data["group"] == group).sum()) for group in groups)
    names = {level: _wrapped(levels.text(level), NAME_LETTERS) for level in levels.labels}
    gained, over = f"gain in {metric} (AP)", f"over {levels.text(levels.baseline)}"
    is_short = len(gained) + len(over) < LABEL_LETTERS
    label = f"{gained} {over}" if is_short else f"{gained}\n{_wrapped(over, LABEL_LETTERS)}"

    def panel(axes: Axes, group: str) -> None:
        own = levels.sorted(data[data["group"] == group])
        axes.axvspan(-margin, margin, color="0.92", lw=0, zorder=0)
        axes.axvline(0, color="0.4", lw=0.8, zorder=1)
        for place, row in enumerate(own.to_dict("records")):
            _draw(axes, place, row, reach)
        axes.set_yticks(np.arange(len(own)), [names[str(level)] for level in own["level"]])
        axes.set_ylim(tallest - 0.4, -0.7)
        axes.set_xlim(-reach, reach)
        axes.set_xlabel(label, fontsize=7)
        axes.tick_params(axis="y", length=0, labelsize=7)
        axes.spines["left"].set_visible(False)

    row = max(ROW, LINE * (1 + max(name.count("\n") + 1 for name in names.values())))
    height = 1.0 + LINE * label.count("\n") + row * tallest
    return Drawn(panels(groups, panel, 5, height), verdicts)


def _wrapped(text: str, letters: int) -> str:
    return textwrap.fill(text, letters, break_on_hyphens=False)


def _draw(axes: Axes, place: int, row: Mapping[Hashable, Any], reach: float) -> None:
    """One level; its numbers stand above its line, and end with it where the middle would push them out."""
    verdict = Verdict(row["verdict"])
    color, marker, is_full = LOOKS[verdict]
    axes.plot([row["gain_low"], row["gain_high"]], [place, place], color=color, lw=1.4, zorder=2)
    look: Any = {"color": color, "marker": marker, "ms": 5, "ls": "", "zorder": 3}
    look["markerfacecolor"] = color if is_full else "white"
    axes.plot([row["gain"]], [place], label=WORDS.get(verdict, str(verdict)), **look)
    x, side = row["gain"], "center"
    if abs(x) > reach / 2:
        x, side = (row["gain_high"], "right") if x > 0 else (row["gain_low"], "left")
    look = {"fontsize": 5.5, "ha": side, "va": "bottom", "color": "0.15", "path_effects": [HALO]}
    count = f"n = {row['seeds']}{', copies' if row.get('copies') else ''}"
    axes.annotate(f"{gain_text(row, 1)}  {count}", (x, place - 0.2), **look)
