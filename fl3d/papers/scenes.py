"""Frames with what a checkpoint finds in them, for figures."""

from __future__ import annotations

import numpy as np
from PIL import Image

from fl3d.evaluation.detections import read_detections
from fl3d.reports.figures.boxes import Scene
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder

SHOWN = 3  # frames


def scenes_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> list[Scene]:
    """What a checkpoint finds in the validation frames with most cars.

    Args:
        sweep: whose frames and protocol they are.
        folder: of the stage that holds the checkpoint.
        step: of the checkpoint.
    """
    kitti = sweep.kitti()
    stored = read_detections(folder.detections(step))
    cars = np.array(
        [(kitti.read_labels(frame_id).types == "Car").sum() for frame_id in stored.frame_ids]
    )
    scenes = []
    for index in np.argsort(-cars, kind="stable")[:SHOWN]:
        frame = kitti.frame(stored.frame_ids[index])
        found = stored.cars(index, frame.calibration, frame.image_size, sweep.protocol)
        picture = kitti.path("image_2", frame.id)
        image = np.asarray(Image.open(picture).convert("RGB")) if picture.exists() else None
        scenes.append(Scene(frame, image, found))
    return scenes
