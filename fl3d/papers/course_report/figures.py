"""Figures of the course report: overlap over epochs (4), both detectors (6), both stages (7), 2D detections (8)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from fl3d.core.errors import StoreError
from fl3d.papers.base import Feeding
from fl3d.papers.course_report.frustum_tables import DETECTORS, NAMES
from fl3d.papers.scenes import scenes_of
from fl3d.reports.figures.boxes import Scene, boxes_of_models, draw_picture
from fl3d.reports.figures.style import BLUE, PURPLE, Drawn, canvas, panels, styled
from fl3d.reports.levels import slug
from fl3d.runs.drawn import drawn
from fl3d.runs.finished import FinishedSweep

STAGES = ("first stage", "after refinement")
ONE_TRIAL = "Of the sweep's first trial: one level, one seed of training."
CAPTIONS = {
    "report_figure_4_pointrcnn": "Report, as Figure 4, of PointRCNN: overlap over epochs; dotted: second stage. "
    f"{ONE_TRIAL}",
    "report_figure_6": "Report, Figure 6: one frame, the final models of PointRCNN above and of Frustum ConvNet below; "
    "ground truth purple (there green), estimates blue (there red). Of each the first seed of training.",
    "report_figure_7_pointrcnn": "Report, as Figure 7, of PointRCNN: proposals above, refined boxes below. "
    f"{ONE_TRIAL}",
    "report_figure_4_fconvnet": "Report, Figure 4: overlap of cars over epochs; dotted: refinement sets in. "
    f"{ONE_TRIAL}",
    "report_figure_7_fconvnet": "Report, Figure 7: Frustum ConvNet before and after refinement. "
    f"{ONE_TRIAL}",
    "report_figure_8": "Report, Figure 8: 2D detections against ground truth; no model of ours is asked.",
}


def draw(sweep: FinishedSweep, folder: Path, feeding: Feeding) -> list[Path]:
    """Draw the report's figures of a sweep of a detector of two stages; of its first trial.

    Figure 6 is of the final models of both detectors, once both are there.

    Args:
        sweep: that feeds the table of both detectors; its run folders must be at hand.
        folder: of the figures.
        feeding: finds the sweeps that feed that table with it.

    Raises:
        StoreError: its trials have one stage.
    """
    if DETECTORS.name not in sweep.settings.sweep.tables:
        return []
    trial = sweep.trials[0]
    if len(trial.folders) < 2:
        raise StoreError(f"{trial.key}: the report's figures need a trial of two stages")
    own = sweep.scores[sweep.scores["trial"] == trial.key]
    name = slug(trial.detector).replace("-", "")
    epochs = folder / f"report_figure_4_{name}"
    written = drawn(sweep.drawn_as, epochs, partial(overlap_over_epochs, own))
    first, second = trial.folders[-2:]
    scenes = {
        STAGES[0]: scenes_of(sweep, first, trial.plan.first_own_step),
        STAGES[1]: scenes_of(sweep, second, trial.last_step),
    }
    both = partial(boxes_of_models, scenes, sweep.protocol.ignore_beyond)
    written += drawn(sweep.drawn_as, folder / f"report_figure_7_{name}", both)
    shown = scenes[STAGES[0]]
    if all(scene.frame.image_boxes is not None for scene in shown):
        written += drawn(sweep.drawn_as, folder / "report_figure_8", partial(figure_8, shown))
    return written + figure_6(feeding(DETECTORS), folder / DETECTORS.joint_figure)


def figure_6(sweeps: Sequence[FinishedSweep], path: Path) -> list[Path]:
    """The report's Figure 6: what the final models of both detectors find in one frame, that with most cars.

    Args:
        sweeps: that feed the table of both detectors, whose final models these are.
        path: without ending.

    Returns:
        every file written; none where a detector is missing, or its run folders are.
    """
    at_hand = [sweep for sweep in sweeps if sweep.is_from_store]
    models: dict[str, list[Scene]] = {}
    for detector, name in NAMES.items() if at_hand else ():
        rows = DETECTORS.models(at_hand, detector)
        if len(rows):
            first = rows.sort_values("seed").iloc[0]
            key, step = str(first["trial"]), int(first["step"])
            sweep = next(one for one in at_hand if any(own.key == key for own in one.trials))
            models[name] = scenes_of(sweep, sweep.trial(key).holder(step), step)[:1]
    frames = {own[0].frame.id for own in models.values()}
    if len(models) < len(NAMES) or len(frames) > 1:
        return []
    figure = partial(boxes_of_models, models, at_hand[0].protocol.ignore_beyond)
    return drawn(at_hand[0].drawn_as, path, figure)


def overlap_over_epochs(scores: pd.DataFrame) -> Drawn:
    """The report's Figure 4: the cars' mean best overlap over epochs, and the share of those above 0.5 and 0.7.

    Args:
        scores: tidy, of one trial.
    """
    lines = {
        "recall_3d/mean_iou": "mean IoU",
        "recall_3d/0.5": "IoU > 0.5",
        "recall_3d/0.7": "IoU > 0.7",
    }
    data = scores.sort_values("step")[["detector", "epoch", "step", *lines]].reset_index(drop=True)
    fork = data[data["step"] <= scores["first_own_step"].iloc[0]]["epoch"].max()

    def panel(axes: Axes, detector: str) -> None:
        for (key, label), style in zip(lines.items(), ("-", "--", ":"), strict=True):
            axes.plot(
                data["epoch"],
                data[key],
                color=BLUE,
                ls=style,
                marker="o",
                ms=2.5,
                lw=1,
                label=label,
            )
        if np.isfinite(fork):
            axes.axvline(fork, color="0.6", lw=0.8, ls=":")
        axes.set_xlabel("epoch")
        axes.set_ylabel("3D overlap of cars, and shares above")
        axes.set_ylim(0, 1)

    return Drawn(panels(sorted(data["detector"].unique()), panel, 3), data)


def figure_8(scenes: list[Scene], least: float = 0.5) -> Drawn:
    """The report's Figure 8: 2D boxes of labels, and of a 2D detector where its score is at least ``least``.

    Args:
        scenes: frames with ``image_boxes``.
        least: score.
    """
    with styled():
        figure, grid = canvas(len(scenes), 1, (5, 1.6 * len(scenes)))
        for axes, scene in zip(grid[:, 0], scenes, strict=True):
            assert scene.frame.image_boxes is not None
            draw_picture(axes, scene)
            labels = scene.frame.labels
            found = scene.frame.image_boxes[scene.frame.image_boxes[:, 4] >= least]
            both = (
                (labels.boxes_image[labels.types == "Car"], PURPLE, "ground truth"),
                (found, BLUE, "2D detector"),
            )
            for boxes, color, label in both:
                axes.plot([], [], color=color, lw=1, label=label)
                for x1, y1, x2, y2 in boxes[:, :4]:
                    axes.plot([x1, x2, x2, x1, x1], [y1, y1, y2, y2, y1], color=color, lw=0.8)
            width, height = scene.frame.image_size
            axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[], aspect="equal")
        grid[0, 0].legend(loc="upper right", fontsize=6)
        return Drawn(figure)
