"""Run a detector over frames, in evaluation mode."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from fl3d.core.errors import TrainingError
from fl3d.data.dataset import Frames
from fl3d.detectors.base import Batch, Detector, Found, Sample, WindowDetector
from fl3d.evaluation.detections import Detections
from fl3d.inference.precision import multiplying


class _Looks(Dataset[Sample]):
    """Encoded frames in order."""

    def __init__(self, detector: Detector, frames: Frames, with_targets: bool) -> None:
        self.detector, self.frames, self.with_targets = detector, frames, with_targets

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, i: int) -> Sample:
        rng = np.random.default_rng([0, i])
        return self.detector.encode(self.frames[i], rng, training=self.with_targets)


def to_device(batch: Batch, device: str) -> Batch:
    """Move a batch; the CPU's own stays as it is."""
    return (
        batch if device == "cpu" else {k: v.to(device, non_blocking=True) for k, v in batch.items()}
    )


def detect_frames(
    detector: Detector,
    frames: Frames,
    max_boxes: int,
    min_score: float,
    device: str = "cpu",
    precision: str = "float32",
    batch_size: int = 1,
    workers: int = 0,
    after_batch: Callable[[], None] = lambda: None,
    take_positives: Callable[[Tensor], None] | None = None,
) -> Detections:
    """Run a detector over frames in evaluation mode; the random states of training are not touched.

    Args:
        detector: the network.
        frames: validation frames.
        max_boxes: stored per frame.
        min_score: stored above.
        device: of the network.
        precision: see ``precision.PRECISIONS``.
        batch_size: frames at once.
        workers: loader processes; 0 loads in this one.
        after_batch: called after each batch, to show progress.
        take_positives: called with the logits of each batch's positive windows, (P,); they cost a frame's targets, and
            no pass of their own. Of a ``WindowDetector`` alone.
    """
    detector.eval()
    found: list[Found] = []
    started = time.monotonic()
    loader = DataLoader(
        _Looks(detector, frames, take_positives is not None),
        batch_size,
        collate_fn=detector.collate,
        num_workers=workers,
        generator=torch.Generator(),  # its own, see ``Trainer._loader``
    )
    for batch in loader:
        with multiplying(precision, device):
            batch = to_device(batch, device)
            if take_positives is None:
                found += detector.detect(batch, max_boxes, min_score)
            else:
                assert isinstance(detector, WindowDetector)
                own, positives = detector.detect_with_positives(batch, max_boxes, min_score)
                take_positives(positives)
                found += own
        if time.monotonic() - started > 1:
            started = time.monotonic()
            after_batch()
    counts = [len(f.scores) for f in found]
    types = [f.types(detector.classes) for f in found] or [None]
    images = [f.boxes_image for f in found if f.boxes_image is not None]
    if images and sum(map(len, images)) != sum(counts):
        raise TrainingError(
            f"{detector.NAME}: boxes of some frames have 2D boxes of their own, of others none"
        )
    return Detections(
        frames.ids,
        np.repeat(np.arange(len(found)), counts),
        np.concatenate([f.boxes_velo for f in found]),
        np.concatenate([f.scores for f in found]),
        np.concatenate(images) if images else None,
        None if types[0] is None else np.concatenate([one for one in types if one is not None]),
    )
