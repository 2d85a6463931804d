"""Frames with what a checkpoint finds in them, for figures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import read_picture
from fl3d.evaluation.detections import read_detections
from fl3d.reports.figures.boxes import Scene
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder
from fl3d.simulator.again import picture_again

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
        scenes.append(Scene(frame, _image(kitti, frame.id), found, sweep.classes))
    return scenes


def _image(kitti: KittiFolder, frame_id: str) -> NDArray[np.uint8] | None:
    """A frame's picture, that of a simulated one rendered now if need be; None where there is none."""
    path = kitti.path("image_2", frame_id)
    return read_picture(path) if path.exists() else picture_again(kitti.root, frame_id)
