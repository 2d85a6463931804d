"""Figures of APs of any sweep: against steps, level and score cut, and precision against recall.

A panel a group, a curve a level.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from fl3d.reports.figures.style import BLUE, ORANGE, Drawn, draw_by_level, panels, shades
from fl3d.reports.levels import Levels, ap_columns

MARKS = {"easy": ("^", ":"), "moderate": ("o", "-"), "hard": ("v", "--")}
METRIC = "ap_3d/moderate"
ROOM = 0.5  # below and above the curves, as a share of what they reach over
BAND = 0.08  # strength of a band over seeds: above seven that overlap, all lines show in grey


def ap_over_steps(
    scores: pd.DataFrame, last: pd.DataFrame, best: pd.DataFrame, levels: Levels
) -> Drawn:
    """3D AP moderate of every checkpoint; last and best marked, the step at which the last stage begins dotted.

    Curves and marks of a level are means over its own seeds, curves at the steps that all of these have; a band reaches
    from its lowest to its highest seed.

    Args:
        scores: tidy.
        last: the last checkpoint of each trial.
        best: likewise.
        levels: of the sweep.
    """
    data = scores[["trial", "group", "level", "seed", "step", METRIC]].reset_index(drop=True)
    places = list(zip(data["trial"], data["step"], strict=True))
    for rule, chosen in (("last", last), ("best", best)):
        marked = set(zip(chosen["trial"], chosen["step"], strict=True))
        data = data.assign(**{rule: [place in marked for place in places]})

    def panel(axes: Axes, group: str) -> None:
        own = data[data["group"] == group]
        for level, (color, _) in shades(levels.labels):
            some = own[own["level"] == level]
            if some.empty:
                continue
            by_step = _at_common_steps(some)
            if some["seed"].nunique() > 1:
                look = {"color": color, "alpha": BAND, "lw": 0, "zorder": 1}
                axes.fill_between(by_step.index, by_step["min"], by_step["max"], **look)
            axes.plot(by_step.index, by_step["mean"], color=color, lw=1, label=levels.text(level))
            for rule, marker, size in (("last", "o", 3), ("best", "*", 6)):
                at = some[some[rule]][["step", METRIC]].mean()
                axes.plot(at["step"], at[METRIC], color=color, ls="", marker=marker, ms=size)
        _draw_forks(axes, scores[scores["group"] == group], levels)
        axes.plot([], [], color="0.3", ls="", marker="o", ms=3, label="last")
        axes.plot([], [], color="0.3", ls="", marker="*", ms=6, label="best")
        axes.set_xlabel("training step")
        axes.set_ylabel("3D AP moderate (%)")

    shown = data.drop(columns="trial")
    return Drawn(panels(sorted(data["group"].unique()), panel, 5), shown)


def _at_common_steps(some: pd.DataFrame) -> pd.DataFrame:
    """Mean, lowest and highest of the seeds of one level; seeds may have checkpoints that others lack."""
    by_step = some.groupby("step")[METRIC].agg(["mean", "min", "max", "count"])
    return by_step[by_step["count"] == some["seed"].nunique()]


def _draw_forks(axes: Axes, own: pd.DataFrame, levels: Levels) -> None:
    """Where last stages begin: one line where all begin together, else one of each level in its colour."""
    every = own["first_own_step"].unique()
    if len(every) == 1:
        axes.axvline(every[0], color="0.6", lw=0.8, ls=":")
        return
    for level, (color, _) in shades(levels.labels):
        for fork in own[own["level"] == level]["first_own_step"].unique():
            axes.axvline(fork, color=color, lw=0.8, ls=":")


def ap_over_level(last: pd.DataFrame, levels: Levels, gains: pd.DataFrame | None = None) -> Drawn:
    """APs of the last models against the level (evenly spaced); thin lines: the baseline.

    Args:
        last: the last checkpoint of each trial; seeds are averaged.
        levels: of the sweep.
        gains: see ``analysis.gains.gains``; with it, 3D moderate has its 95 % intervals as bars, and APs are of the
            seeds that these are of. A level without gains keeps the mean of its own seeds, and has no bar.
    """
    metrics = list(ap_columns("R11").values())
    data = last.groupby(["group", "level"])[metrics].mean().reset_index()
    data = data if gains is None else _with_intervals(data, gains)
    data = levels.sorted(data).sort_values("group", kind="stable").reset_index(drop=True)

    def panel(axes: Axes, group: str) -> None:
        own = data[data["group"] == group]
        places = np.arange(len(own))
        base = own[own["level"] == levels.baseline]
        for view, color, shift in (("bev", ORANGE, -0.08), ("3d", BLUE, 0.08)):
            for difficulty, (marker, line) in MARKS.items():
                metric = f"ap_{view}/{difficulty}"
                label = f"{view.upper()} {difficulty}"
                axes.plot(
                    places + shift,
                    own[metric],
                    color=color,
                    marker=marker,
                    ms=4,
                    lw=1,
                    ls=line,
                    label=label,
                )
                if metric == METRIC and f"{metric} low" in own:
                    _bars(axes, places + shift, own, color)
                if len(base):
                    axes.axhline(base[metric].iloc[0], color=color, lw=0.5, ls=line, alpha=0.4)
        _keep_in_sight(axes, own[metrics].to_numpy())
        names = [
            re.sub(r" (?=[\w.]+=)", "\n", str(level)) for level in own["level"]
        ]  # a line a key
        is_turned = max(len(level) for level in own["level"]) > 6
        turn, side = (30, "right") if is_turned else (0, "center")
        axes.set_xticks(places, names, rotation=turn, ha=side, rotation_mode="anchor")
        axes.set_xlabel(levels.head)
        axes.set_ylabel("AP of the last model (%)")

    return Drawn(panels(sorted(data["group"].unique()), panel, 3, 3.2), data)


def _keep_in_sight(axes: Axes, aps: np.ndarray) -> None:
    """Let bars leave the panel where they would press the curves flat: of two seeds they reach over 50 AP."""
    low, high = float(aps.min()), float(aps.max())
    room = max(high - low, 5.0) * ROOM
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - room), min(top, high + room))


def _bars(axes: Axes, places: np.ndarray, own: pd.DataFrame, color: str) -> None:
    """From end to end of the intervals, which hold the value, but seldom in their middle."""
    low, high = own[f"{METRIC} low"].to_numpy(), own[f"{METRIC} high"].to_numpy()
    middle, half = (low + high) / 2, (high - low) / 2
    axes.errorbar(places, middle, half, fmt="none", ecolor=color, elinewidth=0.7, capsize=1.5)


def _with_intervals(means: pd.DataFrame, gains: pd.DataFrame) -> pd.DataFrame:
    """APs and the ends of their intervals, a column for each metric; a group without gains keeps its means."""
    own = gains[gains["average"] == "R11"].copy()
    own["name"] = "ap_" + own["metric"] + "/" + own["difficulty"]
    places = ["group", "level"]
    wide = own.pivot(index=places, columns="name", values=["ap", "ap_low", "ap_high"])
    ends = [wide[f"ap_{end}"].add_suffix(f" {end}") for end in ("low", "high")]
    data = means.merge(pd.concat(ends, axis=1).reset_index(), on=places, how="left")
    keys = pd.MultiIndex.from_frame(data[places])
    for name, aps in wide["ap"].items():
        if name in data:
            data[name] = aps.reindex(keys).fillna(data[name].set_axis(keys)).to_numpy()
    return data


def ap_over_cut(rescored: pd.DataFrame, levels: Levels) -> Drawn:
    """3D AP moderate of the last models against the score below which detections are dropped.

    Args:
        rescored: a row a trial and cut: ``group``, ``level``, ``score_threshold``, ``ap_3d/moderate``.
        levels: of the sweep.
    """
    data = rescored.assign(cut=rescored["score_threshold"].astype(float))
    data = data.groupby(["group", "level", "cut"])[METRIC].mean().reset_index()

    def panel(axes: Axes, group: str) -> None:
        draw_by_level(axes, data[data["group"] == group], levels, "cut", METRIC)
        axes.set_xlabel("score cut")
        axes.set_ylabel("3D AP moderate (%)")

    return Drawn(panels(sorted(data["group"].unique()), panel, 4), data)


def precision_recall(
    curves: pd.DataFrame, levels: Levels, groups: Sequence[str] | None = None
) -> Drawn:
    """Precision against recall, a panel a group.

    Args:
        curves: ``group``, ``level``, ``recall`` and ``precision``; seeds averaged.
        levels: of the sweep.
        groups: in the order of their panels; None: sorted.
    """

    def panel(axes: Axes, group: str) -> None:
        draw_by_level(axes, curves[curves["group"] == group], levels, "recall", "precision", 4)
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))

    names = sorted(curves["group"].unique()) if groups is None else groups
    return Drawn(panels(names, panel, 4), curves)


def best_of_k_figure(data: pd.DataFrame, levels: Levels) -> Drawn:
    """Mean 3D AP moderate of the best of k checkpoints of a trial's last stage: what looking k times is worth.

    Args:
        data: see ``analysis.split_halves.best_of_k_checkpoints``.
        levels: of the sweep.
    """

    def panel(axes: Axes, group: str) -> None:
        draw_by_level(axes, data[data["group"] == group], levels, "k", "best")
        axes.set_xlabel("checkpoints looked at, k")
        axes.set_ylabel("best 3D AP moderate, mean (%)")

    return Drawn(panels(sorted(data["group"].unique()), panel, 4), data)
