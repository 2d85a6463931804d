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
    """What a checkpoint finds in the validation frames with most objects.

    Args:
        sweep: whose frames and protocol they are.
        folder: of the stage that holds the checkpoint.
        step: of the checkpoint.
    """
    kitti = sweep.kitti()
    stored = read_detections(folder.detections(step))
    counts = np.array(
        [np.isin(kitti.read_labels(one).types, sweep.classes).sum() for one in stored.frame_ids]
    )
    scenes = []
    for index in np.argsort(-counts, kind="stable")[:SHOWN]:
        frame = kitti.frame(stored.frame_ids[index])
        found = stored.labels_of(index, frame.calibration, frame.image_size, sweep.protocol)
        picture = kitti.path("image_2", frame.id)
        image = np.asarray(Image.open(picture).convert("RGB")) if picture.exists() else None
        scenes.append(Scene(frame, image, found, sweep.classes))
    return scenes
