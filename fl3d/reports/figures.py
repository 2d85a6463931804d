"""Figures of a sweep: AP against step and against gamma; one frame from above. PNG and PDF, data beside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fl3d.data.kitti import Frame
from fl3d.data.labels import Labels
from fl3d.files import write_atomically, write_text
from fl3d.geometry.boxes import Array, corners_velo
from fl3d.reports.selection import select
from fl3d.reports.table import AP_COLUMNS

STYLE: Any = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
PURPLE, BLUE = "#7b2d8b", "#1f5fbf"  # ground truth and estimates, as in the paper's Figure 1
FOOTPRINT = (0, 1, 5, 2, 0)  # corners around the bottom face


METADATA = {".png": {"Software": None}, ".pdf": {"CreationDate": None, "Producer": None, "Creator": None}}


def save(figure: Figure, path: Path, endings: tuple[str, ...] = (".png", ".pdf")) -> list[Path]:
    """Write a figure without dates, so that the same data give the same bytes."""
    written = []
    for ending in endings:
        values = METADATA[ending]
        target = path.with_suffix(ending)

        def draw(temporary: Path, kind: str = ending[1:], values: dict[str, None] = values) -> None:
            figure.savefig(temporary, format=kind, metadata=values, dpi=200)

        write_atomically(target, draw)
        written.append(target)
    plt.close(figure)
    return written


def ap_over_steps(scores: pd.DataFrame, path: Path) -> list[Path]:
    """3D AP moderate of every checkpoint; one panel a detector, one curve a gamma, the fork marked."""
    columns = ["detector", "gamma", "step", "ap_3d/moderate"]
    write_text(path.with_suffix(".csv"), scores.sort_values(columns[:3])[columns].to_csv(index=False))

    def panel(axes: Axes, detector: str, own: pd.DataFrame) -> None:
        gammas = sorted(own["gamma"].unique())
        shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.9, len(gammas)))
        for gamma, shade in zip(gammas, shades, strict=True):
            curve = own[own["gamma"] == gamma].sort_values("step")
            axes.plot(curve["step"], curve["ap_3d/moderate"], color=shade, marker=".", lw=1, label=f"γ = {gamma:g}")
        axes.axvline(own["first_own_step"].iloc[0], color="0.6", lw=0.8, ls=":")
        axes.set_xlabel("training step")
        axes.set_ylabel("3D AP moderate (%)")

    return _panels(scores, path, panel, legend_columns=7)


def ap_over_gamma(scores: pd.DataFrame, path: Path) -> list[Path]:
    """APs of the last models against gamma (evenly spaced); dashed: gamma = 0."""
    last = select(scores, "last").sort_values(["detector", "gamma"])
    write_text(path.with_suffix(".csv"), last[["detector", "gamma", "step", *AP_COLUMNS.values()]].to_csv(index=False))

    def panel(axes: Axes, detector: str, own: pd.DataFrame) -> None:
        own = own.sort_values("gamma")
        places = np.arange(len(own))
        for view, color in (("bev", "#d07a1c"), ("3d", BLUE)):
            for level, marker in (("easy", "^"), ("moderate", "o"), ("hard", "v")):
                aps = own[f"ap_{view}/{level}"].to_numpy()
                axes.plot(places, aps, color=color, marker=marker, ms=4, lw=1, label=f"{view.upper()} {level}")
                if own["gamma"].iloc[0] == 0:
                    axes.axhline(aps[0], color=color, lw=0.5, ls="--", alpha=0.5)
        axes.set_xticks(places, [f"{gamma:g}" for gamma in own["gamma"]])
        axes.set_xlabel("γ")
        axes.set_ylabel("AP of the last model (%)")

    return _panels(last, path, panel, legend_columns=6)


def _panels(
    scores: pd.DataFrame, path: Path, panel: Callable[[Axes, str, pd.DataFrame], None], legend_columns: int
) -> list[Path]:
    detectors = sorted(scores["detector"].unique())
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(
            1, len(detectors), figsize=(3.6 * len(detectors), 2.9), squeeze=False, layout="constrained"
        )
        for axes, detector in zip(grid[0], detectors, strict=True):
            panel(axes, detector, scores[scores["detector"] == detector])
            axes.set_title(detector)
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, fontsize=7, frameon=False, ncols=legend_columns, loc="outside lower center")
        return save(figure, path)


def birds_eye(
    frame: Frame, detections: Labels, beyond: tuple[float, float, float, float] | None, title: str, path: Path
) -> list[Path]:
    """One frame from above: points, cars (purple) and estimates (blue, with scores; the surer the stronger).

    Args:
        frame: cloud and labels.
        detections: as evaluated.
        beyond: area of the evaluation, or None.
        title: above it.
        path: without ending.
    """
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(5, 4.6))
        points = frame.points_velo
        axes.scatter(points[:, 0], points[:, 1], s=0.15, c="0.55", linewidths=0, rasterized=True)
        cars = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[frame.labels.types == "Car"])
        found = frame.calibration.boxes_to_velo(detections.boxes_cam)
        scores = detections.scores if detections.scores is not None else np.zeros(0)
        strength = np.clip(scores, 0.15, 1)
        _outlines(axes, cars, PURPLE, "ground truth", np.ones(len(cars)))
        _outlines(axes, found, BLUE, "estimate", strength)
        for box, score, alpha in zip(found, scores, strength, strict=True):
            axes.annotate(f"{score:.2f}", box[:2], fontsize=4, color=BLUE, ha="center", va="center", alpha=alpha)
        x0, y0, x1, y1 = beyond or (0, -40, 70.4, 40)
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
        axes.legend(loc="upper left", fontsize=6)
        return save(figure, path, (".png",))  # one for each trial, to look at in MLflow


def _outlines(axes: Axes, boxes_velo: Array, color: str, label: str, strength: Array) -> None:
    axes.plot([], [], color=color, lw=1, label=label)
    for corners, alpha in zip(corners_velo(boxes_velo), strength, strict=True):
        axes.plot(*corners[list(FOOTPRINT), :2].T, color=color, lw=1, alpha=float(alpha))
