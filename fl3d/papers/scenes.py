"""Frames with what a checkpoint finds in them, for figures."""

from __future__ import annotations

from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.digests import file_digest
from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import read_picture
from fl3d.evaluation.detections import read_detections
from fl3d.reports.figures.boxes import Scene
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, kept
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.simulator.again import MANIFEST, picture_again

# What renders.
CODE = ("core", "geometry", "data", "simulator")
LIBRARIES = ("numpy", "numba")
SHOWN = 3  # frames


def scenes_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> list[Scene]:
    """What a checkpoint finds in the validation frames with most objects.

    Args:
        sweep: whose frames and protocol they are.
        folder: of the stage that holds the checkpoint.
        step: of the checkpoint.
    """
    kitti = sweep.kitti()
    labels = dict(zip(sweep.validation.ids, sweep.validation.labels, strict=True))
    stored = read_detections(folder.detections(step))
    counts = np.array([np.isin(labels[one].types, sweep.classes).sum() for one in stored.frame_ids])
    scenes = []
    for index in np.argsort(-counts, kind="stable")[:SHOWN]:
        frame = kitti.frame(stored.frame_ids[index])
        found = stored.labels_of(index, frame.calibration, frame.image_size, sweep.protocol)
        scenes.append(Scene(frame, _image(sweep, kitti, frame.id), found, sweep.classes))
    return scenes


def _image(sweep: FinishedSweep, kitti: KittiFolder, frame_id: str) -> NDArray[np.uint8] | None:
    """A frame's picture, that of a simulated one rendered if need be and kept; None where there is none."""
    path = kitti.path("image_2", frame_id)
    if path.exists():
        return read_picture(path)
    try:
        told = file_digest(kitti.root / MANIFEST)
    except OSError:  # nobody has simulated it
        return None
    made_of = {
        "manifest": told,
        "frame": frame_id,
        "code": code_digest(*CODE),
        "libraries": [version(one) for one in LIBRARIES],
    }
    place = StoreFolder(sweep.settings.store.root).kept(f"picture-{told[:10]}-{frame_id}")
    found = kept(place, made_of, partial(_rendered, kitti.root, frame_id))
    return found.get("pixels")


def _rendered(root: Path, frame_id: str) -> Arrays:
    pixels = picture_again(root, frame_id)
    return {} if pixels is None else {"pixels": pixels}
