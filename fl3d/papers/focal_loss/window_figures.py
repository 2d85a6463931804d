"""Figures of windows' posteriors and losses: Figures 4 and 5, Figure 1 of the arXiv version, imbalance by height."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fl3d.reports.figures.style import BLUE, ORANGE, Drawn, draw_by_level, panels
from fl3d.reports.levels import Levels

Array = NDArray[np.floating]
POINTS = (
    200  # of a curve in Figure 4: evenly spaced, and as many again over the hardest thousandths
)
BINS = 25
ROOM = 1.4  # above and below the curves of Figure 5, which has one scale for all its panels
# What "positive bounding boxes" of "all the evaluation results" may be (§VI-C), the nearest to the words first: all
# boxes that the evaluation gets; of these the ones that it counts as found cars; windows that the labels make positive.
BOXES, HITS, WINDOWS = KINDS = ("evaluated boxes", "evaluated boxes on cars", "positive windows")


def cumulative_loss(logits: Array, sign: int, gamma: float, shares: Array) -> Array:
    """Share of the total focal loss that lies on the easiest windows.

    Args:
        logits: of windows, (N,).
        sign: +1 for positives, -1 for negatives.
        gamma: focusing parameter.
        shares: of the windows, from 0 to 1, easiest first.

    Returns:
        as long as ``shares``.
    """
    x = sign * logits.astype(np.float64)
    losses = np.exp(-gamma * np.logaddexp(0, x)) * np.logaddexp(
        0, -x
    )  # (1 - p_t)^gamma * -log(p_t), Eq. 4
    sums = np.concatenate([[0.0], np.cumsum(np.sort(losses))])
    total = sums[-1] or 1.0
    filled: Array = np.interp(shares * len(losses), np.arange(len(sums)), sums / total)
    return filled


def focal_curves(gammas: Sequence[float]) -> Drawn:
    """Figure 1 of the arXiv version: the focal loss of one window over its posterior probability (Eq. 4).

    Args:
        gammas: a curve each.
    """
    p_t = np.linspace(1, 100, 199) / 100  # at 0 the loss is infinite
    parts = []
    for gamma in gammas:
        loss = -((1 - p_t) ** gamma) * np.log(p_t)
        parts.append(pd.DataFrame({"gamma": gamma, "p_t": p_t, "loss": np.abs(loss)}))
    data = pd.concat(parts, ignore_index=True)

    def panel(axes: Axes, name: str) -> None:
        _draw(axes, data, "p_t", "loss", 0.12)
        axes.axvspan(0.5, 1, color="0.94", lw=0)
        axes.text(0.75, 4.6, "classified well", ha="center", fontsize=7, color="0.35")
        axes.set(xlabel="posterior probability of a window", ylabel=name, xlim=(0, 1), ylim=(0, 5))

    return Drawn(panels(["focal loss"], panel, 4), data)


def figure_4(sampled: Mapping[str, tuple[Array, Array]], gammas: list[float]) -> Drawn | None:
    """Figure 4: cumulative normalised loss of positives and of negatives, for each gamma; None without a detector.

    Args:
        sampled: by detector, logits of positive and of negative windows of its best focal model.
        gammas: the loss is computed anew for each from the same posteriors.
    """
    if not sampled:
        return None
    shares = np.unique(np.concatenate([np.linspace(0, 1, POINTS), np.linspace(0.998, 1, POINTS)]))
    rows = []
    for detector, pair in sampled.items():
        for kind, sign, logits in zip(("positives", "negatives"), (1, -1), pair, strict=True):
            for gamma in gammas:
                losses = cumulative_loss(logits, sign, gamma, shares)
                part = {
                    "detector": detector,
                    "windows": kind,
                    "gamma": gamma,
                    "share": shares,
                    "loss": losses,
                }
                rows.append(pd.DataFrame(part | {"sampled": len(logits)}))
    data = pd.concat(rows, ignore_index=True)
    names = {
        f"{detector}, {kind}": (detector, kind)
        for detector in sampled
        for kind in ("positives", "negatives")
    }

    def panel(axes: Axes, name: str) -> None:
        detector, kind = names[name]
        own = data[(data["detector"] == detector) & (data["windows"] == kind)]
        _draw(axes, own, "share", "loss", 0.09)
        if name == "VoxelNet, negatives":
            axes.set_xlim(0.998, 1)  # as the paper zooms
        axes.set_xlabel(f"share of the {kind}, easiest first")
        axes.set_ylabel("cumulative normalised loss")

    return Drawn(panels(list(names), panel, 7, 2.6), data)


def _levels(gammas: Iterable[float]) -> Levels:
    labels = [f"{gamma:g}" for gamma in sorted(set(gammas))]
    return Levels("gamma", labels, labels[0])


def _draw(axes: Axes, own: pd.DataFrame, x: str, y: str, every: float) -> None:
    """A curve for each gamma."""
    told = own.assign(level=own["gamma"].map(lambda gamma: f"{gamma:g}"))
    draw_by_level(axes, told, _levels(own["gamma"]), x, y, every)


def figure_5(pooled: Mapping[tuple[str, str, float], Array]) -> Drawn:
    """Figure 5: histograms of the posterior probability of positives, by gamma; last models.

    Args:
        pooled: by detector, what is taken for its positives (one of ``KINDS``) and gamma.
    """
    edges = np.linspace(0, 1, BINS + 1)
    rows = []
    for detector, kind, gamma in sorted(
        pooled, key=lambda key: (key[0], KINDS.index(key[1]), key[2])
    ):
        p = pooled[detector, kind, gamma]
        density = np.histogram(p, bins=edges)[0] / max(1, len(p)) * BINS
        part = {
            "detector": detector,
            "positives": kind,
            "gamma": gamma,
            "posterior": (edges[:-1] + edges[1:]) / 2,
            "density": density,
        }
        rows.append(pd.DataFrame(part | {"count": len(p)}))
    data = pd.concat(rows, ignore_index=True)
    detectors = sorted(data["detector"].unique())
    names = {f"{detector}, {kind}": (detector, kind) for kind in KINDS for detector in detectors}

    seen = data.assign(density=data["density"].where(data["density"] > 0))  # no logarithm of none
    reach = (seen["density"].min() / ROOM, seen["density"].max() * ROOM)

    def panel(axes: Axes, name: str) -> None:
        detector, kind = names[name]
        own = seen[(seen["detector"] == detector) & (seen["positives"] == kind)]
        _draw(axes, own, "posterior", "density", 3)
        axes.set(xlabel="posterior probability", ylabel="density (log)", yscale="log")
        axes.set(xlim=(0, 1), ylim=reach)

    return Drawn(panels(list(names), panel, 4, 2.4), data)


def imbalance_by_height(data: pd.DataFrame) -> Drawn:
    """Positive windows of 3D-FCN a frame, and negatives for each of them, by height (§III-B).

    Args:
        data: ``z_low`` and ``z_high`` in metres (LiDAR frame), ``positives`` and ``negatives`` a frame.
    """
    middle = (data["z_low"] + data["z_high"]) / 2
    height = (data["z_high"] - data["z_low"]).iloc[0] * 0.8

    def panel(axes: Axes, name: str) -> None:
        if name.startswith("positives"):
            axes.barh(middle, data["positives"], height, color=BLUE)
            axes.set_xlabel("positive windows a frame")
        else:
            met = data["positives"] > 0
            axes.barh(
                middle[met],
                (data["negatives"] / data["positives"].where(met))[met],
                height,
                color=ORANGE,
            )
            axes.set_xscale("log")
            axes.set_xlabel("negative windows for each positive")
        axes.set_ylabel("height of the window, LiDAR frame (m)")

    return Drawn(panels(["positives", "imbalance"], panel, 1), data)
