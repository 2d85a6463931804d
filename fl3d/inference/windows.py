"""Posteriors of a checkpoint's windows on validation frames: what Figures 4 and 5 are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from fl3d.core.files import write_atomically
from fl3d.data.dataset import Frames
from fl3d.detectors.base import Detector
from fl3d.inference.detect import to_device
from fl3d.inference.load import load
from fl3d.inference.precision import multiplying
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec

POSITIVES, NEGATIVES = 100_000, 10_000_000  # sampled at most (paper, §VI-B)


@dataclass(frozen=True)
class Windows:
    """Logits of windows.

    Args:
        positive: (P,) of all positives, or of as many as are sampled.
        negative: (N,) likewise.
        frames: that they are of.
    """

    positive: NDArray[np.float32]
    negative: NDArray[np.float32]
    frames: int


def windows_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> Windows:
    """Windows of a checkpoint; the network is run once, and what it says is kept beside the detections.

    Args:
        sweep: whose frames they are of.
        folder: of the stage that holds the checkpoint.
        step: of the checkpoint.

    Raises:
        CheckpointError: the weights cannot be read.
        DataError: the frames are not there.
    """
    path = folder.windows(step)
    if not path.exists():
        found = _run(sweep, folder, step)
        write_atomically(path, lambda temporary: _save(temporary, found))
    with np.load(path) as stored:
        return Windows(stored["positive"], stored["negative"], int(stored["frames"]))


def _save(path: Path, found: Windows) -> None:
    with path.open("wb") as file:
        np.savez_compressed(
            file, positive=found.positive, negative=found.negative, frames=np.array(found.frames)
        )


def _run(sweep: FinishedSweep, folder: RunFolder, step: int) -> Windows:
    spec = read_spec(folder)
    device = (
        spec.machine.device if torch.cuda.is_available() else "cpu"
    )  # trained elsewhere, perhaps
    frames = Frames(spec.kitti(sweep.kitti().root), spec.machine.val_ids, 0)
    detector = load(folder, step, device)
    with multiplying(spec.settings.precision, device):
        return collect_windows(detector, frames, device)


@torch.no_grad()
def collect_windows(
    detector: Detector,
    frames: Frames,
    device: str = "cpu",
    most_positive: int = POSITIVES,
    most_negative: int = NEGATIVES,
) -> Windows:
    """Run a detector in evaluation mode, frame by frame.

    Args:
        detector: the network.
        frames: validation frames.
        device: of the network.
        most_positive: sampled of all there are.
        most_negative: sampled, of each frame an equal number at most.
    """
    detector.eval()
    limit = -(-most_negative // max(1, len(frames)))
    positives, negatives = [], []
    for i in tqdm(range(len(frames)), desc="windows", unit="frame", leave=False, disable=None):
        rng = np.random.default_rng([0, i])
        batch = to_device(
            detector.collate([detector.encode(frames[i], rng, training=True)]), device
        )
        positive, negative = (logits.float().cpu().numpy() for logits in detector.windows(batch))
        positives.append(positive)
        negatives.append(_sample(negative, limit, rng))
    every = _sample(np.concatenate(positives), most_positive, np.random.default_rng(0))
    return Windows(every, np.concatenate(negatives), len(frames))


def _sample(
    values: NDArray[np.float32], limit: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    return values if len(values) <= limit else rng.choice(values, limit, replace=False)
