"""Figures of the course report on Frustum ConvNet: overlap over epochs (4), both stages (6, 7), 2D detections (8)."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from fl3d.data.kitti import KittiFolder
from fl3d.errors import StoreError
from fl3d.evaluation.detections import read_detections, to_labels
from fl3d.evaluation.protocol import Protocol
from fl3d.records import Config, StagePaths
from fl3d.reports.figures.boxes import Scene, figure_1, figure_8
from fl3d.reports.figures.curves import overlap_over_epochs
from fl3d.rescore import finished_trials
from fl3d.results import results_folder, scores_of

FEEDS = "R7"  # a sweep that feeds this table has both stages
SHOWN = 3  # frames
STAGES = ("first stage", "after refinement")


def write_report_figures(config: Config, say: Callable[[str], None] = print) -> list[Path]:
    """Draw the report's figures of a sweep of a detector of two stages; of its first trial.

    Args:
        config: of the sweep, such as ``frustum_final``.
        say: prints a line for the user.

    Raises:
        StoreError: the sweep was never run here, or is of one stage.
    """
    paths, scores = finished_trials(config)[0], scores_of(config)
    own = scores[scores["trial"] == paths.folder.name]
    parent = json.loads(paths.spec.read_text())["stage"]["parent"]
    if own.empty or parent is None:
        raise StoreError(f"{paths.folder}: the report's figures need the scores of a trial of two stages")
    folder, name = results_folder(config) / "figures", _slug(str(own["detector"].iloc[0]))
    written = overlap_over_epochs(own, folder / f"report_figure_4_{name}")
    first = int(own["first_own_step"].iloc[0])
    ends = {STAGES[0]: (StagePaths(paths.folder.parent / parent), first), STAGES[1]: (paths, paths.steps()[-1])}
    scenes = {label: scenes_of(config, *end) for label, end in ends.items()}
    protocol = Protocol(**config["protocol"])
    written += figure_1(scenes, protocol.ignore_beyond, folder / f"report_figure_6_{name}")
    shown = next(iter(scenes.values()))
    if all(scene.frame.image_boxes is not None for scene in shown):
        written += figure_8(shown, folder / "report_figure_8")
    say(f"Written to {folder}: " + ", ".join(path.name for path in written))
    return written


def feeds(config: Config) -> bool:
    """Whether a sweep has what these figures show."""
    return FEEDS in config["sweep"]["tables"]


def scenes_of(config: Config, paths: StagePaths, step: int) -> list[Scene]:
    """What a checkpoint finds in the validation frames with most cars."""
    machine, data = json.loads(paths.spec.read_text())["machine"], config["data"]
    kitti = KittiFolder(Path(machine["data_root"]), data["crop"], data["calibration"])
    stored, protocol = read_detections(paths.detections(step)), Protocol(**config["protocol"])
    cars = [(kitti.read_labels(i).types == "Car").sum() for i in stored.frame_ids]
    scenes = []
    for index in np.argsort(-np.array(cars), kind="stable")[:SHOWN]:
        frame = kitti.frame(stored.frame_ids[index])
        found = to_labels(*stored.of(index), frame.calibration, frame.image_size, protocol)
        picture = kitti.path("image_2", frame.id)
        image = np.asarray(Image.open(picture).convert("RGB")) if picture.exists() else None
        scenes.append(Scene(frame, image, found))
    return scenes


def _slug(detector: str) -> str:
    return detector.lower().replace("-", "")
