"""Figures of APs: against steps, gamma and score cut, and precision against recall."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from fl3d.reports.figures.style import BLUE, ORANGE, draw_by_gamma, panels, shades, write_data
from fl3d.reports.honest import best_of_k
from fl3d.reports.selection import select
from fl3d.reports.table import AP_COLUMNS

LEVELS = {"easy": ("^", ":"), "moderate": ("o", "-"), "hard": ("v", "--")}


def ap_over_steps(scores: pd.DataFrame, path: Path, stages: str = "last") -> list[Path]:
    """3D AP moderate of every checkpoint; a panel a detector, a curve a gamma, last and best marked, the fork dotted.

    Args:
        scores: tidy; seeds are averaged.
        path: without ending.
        stages: where ``best`` looks, see ``selection.select``.
    """
    metric = "ap_3d/moderate"
    chosen = {rule: select(scores, rule, stages) for rule in ("last", "best")}
    columns = ["detector", "gamma", "seed", "step", metric]
    data = scores.sort_values(columns[:4])[columns].reset_index(drop=True)
    marked = {rule: set(zip(own["trial"], own["step"], strict=True)) for rule, own in chosen.items()}
    places = list(zip(scores.sort_values(columns[:4])["trial"], data["step"], strict=True))
    data = data.assign(**{rule: [place in marked[rule] for place in places] for rule in marked})

    def panel(axes: Axes, detector: str) -> None:
        own = data[data["detector"] == detector]
        gammas = sorted(own["gamma"].unique())
        for gamma, (color, _) in zip(gammas, shades(gammas), strict=True):
            some = own[own["gamma"] == gamma]
            curve = some.groupby("step")[metric].mean()
            axes.plot(curve.index, curve, color=color, lw=1, label=f"γ = {gamma:g}")
            for rule, marker in (("last", "o"), ("best", "*")):
                at = some[some[rule]]
                axes.plot(at["step"], at[metric], color=color, ls="", marker=marker, ms=3 if rule == "last" else 6)
        fork = scores[scores["detector"] == detector]["first_own_step"].iloc[0]
        axes.axvline(fork, color="0.6", lw=0.8, ls=":")
        axes.plot([], [], color="0.3", ls="", marker="o", ms=3, label="last")
        axes.plot([], [], color="0.3", ls="", marker="*", ms=6, label="best")
        axes.set_xlabel("training step")
        axes.set_ylabel("3D AP moderate (%)")

    return [write_data(data, path), *panels(sorted(data["detector"].unique()), path, panel, 5)]


def overlap_over_epochs(scores: pd.DataFrame, path: Path) -> list[Path]:
    """The report's Figure 4: the cars' mean best overlap over epochs, and the share of those above 0.5 and 0.7.

    Args:
        scores: tidy, of one trial.
        path: without ending.
    """
    lines = {"recall_3d/mean_iou": "mean IoU", "recall_3d/0.5": "IoU > 0.5", "recall_3d/0.7": "IoU > 0.7"}
    data = scores.sort_values("step")[["detector", "epoch", "step", *lines]].reset_index(drop=True)
    fork = data[data["step"] <= scores["first_own_step"].iloc[0]]["epoch"].max()

    def panel(axes: Axes, detector: str) -> None:
        for (key, label), style in zip(lines.items(), ("-", "--", ":"), strict=True):
            axes.plot(data["epoch"], data[key], color=BLUE, ls=style, marker="o", ms=2.5, lw=1, label=label)
        if np.isfinite(fork):
            axes.axvline(fork, color="0.6", lw=0.8, ls=":")
        axes.set_xlabel("epoch")
        axes.set_ylabel("3D overlap of cars, and shares above")
        axes.set_ylim(0, 1)

    return [write_data(data, path), *panels(sorted(data["detector"].unique()), path, panel, 3)]


def ap_over_gamma(scores: pd.DataFrame, path: Path, gains: pd.DataFrame | None = None) -> list[Path]:
    """APs of the last models against gamma (evenly spaced); thin lines: gamma = 0.

    Args:
        scores: tidy; seeds are averaged.
        path: without ending.
        gains: see ``gains.gains``; with it, 3D moderate has its 95 % intervals as bars.
    """
    metrics = list(AP_COLUMNS.values())
    last = select(scores, "last").groupby(["detector", "gamma"])[metrics].mean().reset_index()
    data = last if gains is None else last.merge(_ends(gains), on=["detector", "gamma"], how="left")

    def panel(axes: Axes, detector: str) -> None:
        own = data[data["detector"] == detector].sort_values("gamma")
        places = np.arange(len(own))
        for view, color, shift in (("bev", ORANGE, -0.08), ("3d", BLUE, 0.08)):
            for level, (marker, line) in LEVELS.items():
                metric = f"ap_{view}/{level}"
                aps = own[metric].to_numpy()
                label = f"{view.upper()} {level}"
                axes.plot(places + shift, aps, color=color, marker=marker, ms=4, lw=1, ls=line, label=label)
                if f"{metric} low" in own and (view, level) == ("3d", "moderate"):
                    bars = np.maximum(0, [aps - own[f"{metric} low"], own[f"{metric} high"] - aps])
                    axes.errorbar(places + shift, aps, bars, fmt="none", ecolor=color, elinewidth=0.7, capsize=1.5)
                if own["gamma"].iloc[0] == 0:
                    axes.axhline(aps[0], color=color, lw=0.5, ls=line, alpha=0.4)
        axes.set_xticks(places, [f"{gamma:g}" for gamma in own["gamma"]])
        axes.set_xlabel("γ")
        axes.set_ylabel("AP of the last model (%)")

    return [write_data(data, path), *panels(sorted(data["detector"].unique()), path, panel, 3, 3.2)]


def _ends(gains: pd.DataFrame) -> pd.DataFrame:
    """Ends of the intervals of R11, a column for each metric."""
    own = gains[gains["average"] == "R11"].copy()
    own["name"] = "ap_" + own["metric"] + "/" + own["difficulty"]
    parts = []
    for end in ("low", "high"):
        wide = own.pivot_table(index=["detector", "gamma"], columns="name", values=f"ap_{end}")
        parts.append(wide.add_suffix(f" {end}"))
    return pd.concat(parts, axis=1).reset_index()


def ap_over_cut(rescored: pd.DataFrame, path: Path) -> list[Path]:
    """3D AP moderate of the last models against the score below which detections are dropped.

    Args:
        rescored: a row a trial and cut: ``detector``, ``gamma``, ``score_threshold``, ``ap_3d/moderate``.
        path: without ending.
    """
    metric = "ap_3d/moderate"
    data = rescored.assign(cut=rescored["score_threshold"].astype(float))
    data = data.groupby(["detector", "gamma", "cut"])[metric].mean().reset_index()

    def panel(axes: Axes, detector: str) -> None:
        own = data[data["detector"] == detector]
        draw_by_gamma(axes, own, "cut", metric)
        axes.set_xlabel("score cut")
        axes.set_ylabel("3D AP moderate (%)")

    return [write_data(data, path), *panels(sorted(data["detector"].unique()), path, panel, 4)]


def precision_recall(curves: pd.DataFrame, path: Path) -> list[Path]:
    """Precision of the last models against recall, 3D moderate.

    Args:
        curves: ``detector``, ``gamma``, ``recall`` and ``precision``; seeds averaged.
        path: without ending.
    """

    def panel(axes: Axes, detector: str) -> None:
        own = curves[curves["detector"] == detector]
        draw_by_gamma(axes, own, "recall", "precision", 4)
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))

    return [write_data(curves, path), *panels(sorted(curves["detector"].unique()), path, panel, 4)]


def best_of_k_figure(scores: pd.DataFrame, path: Path) -> list[Path]:
    """Mean 3D AP moderate of the best of k checkpoints of a trial's whole curve: what looking k times is worth.

    Args:
        scores: tidy; seeds are averaged.
        path: without ending.
    """
    rows = []
    for (detector, gamma, seed), own in scores.groupby(["detector", "gamma", "seed"]):
        means = best_of_k(own["ap_3d/moderate"].to_numpy())
        part = {"detector": detector, "gamma": gamma, "seed": seed, "k": np.arange(1, len(means) + 1), "best": means}
        rows.append(pd.DataFrame(part))
    data = pd.concat(rows, ignore_index=True).groupby(["detector", "gamma", "k"])["best"].mean().reset_index()

    def panel(axes: Axes, detector: str) -> None:
        own = data[data["detector"] == detector]
        draw_by_gamma(axes, own, "k", "best")
        axes.set_xlabel("checkpoints looked at, k")
        axes.set_ylabel("best 3D AP moderate, mean (%)")

    return [write_data(data, path), *panels(sorted(data["detector"].unique()), path, panel, 4)]
