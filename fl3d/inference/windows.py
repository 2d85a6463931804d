"""Posteriors of networks' windows on validation frames: what Figures 4 and 5 are made of."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fl3d.data.dataset import Frames
from fl3d.detectors.base import Detector
from fl3d.detectors.blocks import as_array
from fl3d.inference.detect import to_device

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


@torch.no_grad()
def collect_windows(
    detectors: Sequence[Detector],
    frames: Frames,
    device: str = "cpu",
    batch_size: int = 1,
    most_positive: int = POSITIVES,
    most_negative: int = NEGATIVES,
    with_negatives: Sequence[bool] | None = None,
) -> list[Windows]:
    """Run detectors in evaluation mode; each frame is encoded once for all.

    Args:
        detectors: networks that differ in their weights alone.
        frames: validation frames.
        device: of the networks.
        batch_size: frames at once, as when they were validated: rounding differs with it, and torch takes seven times
            as long for each frame of 3D-FCN where it has but one (53 and 7 ms, profile quick).
        most_positive: sampled of all there are.
        most_negative: sampled, of each batch an equal number for each of its frames at most.
        with_negatives: of which networks negatives are looked at, the others have none; None: of all.
    """
    wanted = with_negatives or [True] * len(detectors)
    limit = -(-most_negative // max(1, len(frames)))
    positives: list[list[NDArray[np.float32]]] = [[] for _ in detectors]
    negatives: list[list[NDArray[np.float32]]] = [[] for _ in detectors]
    first = detectors[0]
    for detector in detectors:
        detector.eval()
    for start in range(0, len(frames), batch_size):
        own = range(start, min(start + batch_size, len(frames)))
        generators = [np.random.default_rng([0, i]) for i in own]
        encoded = [
            first.encode(frames[i], rng, training=True)
            for i, rng in zip(own, generators, strict=True)
        ]
        batch = to_device(first.collate(encoded), device)
        for place, detector in enumerate(detectors):
            positive, negative = detector.windows(dict(batch))
            positives[place].append(as_array(positive))
            if wanted[place]:
                rng = copy.deepcopy(generators[0])
                negatives[place].append(_sample(as_array(negative), limit * len(own), rng))
    return [
        Windows(
            sampled_positives(met, most_positive),
            np.concatenate(others or [np.zeros(0, dtype=np.float32)]),
            len(frames),
        )
        for met, others in zip(positives, negatives, strict=True)
    ]


def sampled_positives(
    met: Sequence[NDArray[np.float32]], most: int = POSITIVES
) -> NDArray[np.float32]:
    """Logits of positive windows, (P,), of all batches (each (P_b,), in order); of too many a sample."""
    return _sample(np.concatenate(met), most, np.random.default_rng(0))


def _sample(
    values: NDArray[np.float32], limit: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    return values if len(values) <= limit else rng.choice(values, limit, replace=False)
