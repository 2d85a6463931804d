"""The picture that stands beside each trial in the store."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fl3d.core.records import Trial
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.validation import Validation
from fl3d.reports.figures.boxes import birds_eye
from fl3d.runs.layout import StoreFolder


def draw_frame_with_most_objects(
    layout: StoreFolder, kitti: KittiFolder, validation: Validation, protocol: Protocol
) -> Callable[[Trial, int, Path], list[Path]]:
    """What draws a trial's last stage at a step: the validation frame with most objects (the first of them)."""
    counts = [int(np.isin(one.types, protocol.classes).sum()) for one in validation.labels]
    index = counts.index(max(counts))
    frame = kitti.frame(validation.ids[index])

    def draw(trial: Trial, step: int, target: Path) -> list[Path]:
        stored = read_detections(layout.run(trial.key).detections(step))
        found = stored.labels_of(index, frame.calibration, frame.image_size, protocol)
        title = f"{' '.join(trial.overrides)}, step {step}, frame {frame.id}"
        path = target / "birds_eye"
        return birds_eye(frame, found, protocol.ignore_beyond, title, path, protocol.classes)

    return draw
