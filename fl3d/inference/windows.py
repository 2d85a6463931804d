"""Posteriors of checkpoints' windows on validation frames: what Figures 4 and 5 are made of."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fl3d.core.digests import digest, file_digest
from fl3d.core.errors import CheckpointError
from fl3d.data.dataset import Frames
from fl3d.detectors.base import Detector
from fl3d.inference.detect import to_device
from fl3d.inference.load import load
from fl3d.inference.precision import multiplying
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, is_kept, kept
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec

POSITIVES, NEGATIVES = 100_000, 10_000_000  # sampled at most (paper, §VI-B)
# What their values come from, besides weights and frames.
CODE = ("geometry", "data", "losses.py", "sparse", "points", "detectors", "inference")
Place = tuple[RunFolder, int]  # of a checkpoint: the stage that holds it, and its step


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
    """Windows of a checkpoint; the network is run once, and what it says is kept beside the checkpoint.

    Args:
        sweep: whose frames they are of.
        folder: of the stage that holds the checkpoint.
        step: of the checkpoint.

    Raises:
        CheckpointError: the weights cannot be read.
        DataError: the frames are not there.
    """
    found = kept(
        folder.kept(step, "windows"),
        made_of(sweep, folder, step),
        lambda: _as_arrays(_run(sweep, [(folder, step)], [(folder, step)])[0]),
    )
    return Windows(found["positive"], found["negative"], int(found["frames"]))


def positives_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> NDArray[np.float32]:
    """Logits of a checkpoint's positive windows, (P,); the negatives, of which there are many more, are not kept.

    Args:
        sweep: see ``windows_of``.
        folder: likewise.
        step: likewise.

    Raises:
        CheckpointError: likewise.
        DataError: likewise.
    """
    own = made_of(sweep, folder, step)

    def make() -> Arrays:
        if is_kept(folder.kept(step, "windows"), own):
            return {"positive": windows_of(sweep, folder, step).positive}
        return {"positive": _run(sweep, [(folder, step)], ())[0].positive}

    return kept(folder.kept(step, "positives"), own, make)["positive"]


def make_windows(sweep: FinishedSweep, places: Sequence[Place], whole: Collection[Place]) -> None:
    """Make and keep the windows of some checkpoints whose networks read a frame alike, in one pass over the frames.

    Args:
        sweep: whose frames they are of.
        places: checkpoints of one of the groups of ``missing_windows``; their positives are kept.
        whole: those of them whose negatives are kept too.

    Raises:
        CheckpointError: the weights cannot be read.
        DataError: the frames are not there.
    """
    for (folder, step), found in zip(places, _run(sweep, places, whole), strict=True):
        own, arrays = made_of(sweep, folder, step), _as_arrays(found)
        if (folder, step) in whole:
            kept(folder.kept(step, "windows"), own, partial(dict, arrays))
        kept(folder.kept(step, "positives"), own, partial(dict, positive=arrays["positive"]))


def missing_windows(
    sweep: FinishedSweep, places: Sequence[Place], whole: Collection[Place]
) -> list[list[Place]]:
    """Those of some checkpoints whose windows are not kept, by what their networks read of a frame.

    Args:
        sweep: whose frames they are of.
        places: checkpoints whose positives are wanted.
        whole: those of them whose negatives are wanted too.
    """
    groups: dict[str, list[Place]] = {}
    for folder, step in dict.fromkeys(places):
        own = made_of(sweep, folder, step)
        names = ("positives", *(["windows"] if (folder, step) in whole else []))
        if not all(is_kept(folder.kept(step, name), own) for name in names):
            config = read_spec(folder).stage.config
            read = {key: config.get(key) for key in ("detector", "data", "precision")}
            read |= {"batch_size": config["schedule"]["batch_size"]}
            groups.setdefault(digest(read), []).append((folder, step))
    return list(groups.values())


def _as_arrays(found: Windows) -> Arrays:
    frames = np.array(found.frames)
    return {"positive": found.positive, "negative": found.negative, "frames": frames}


def made_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> Mapping[str, Any]:
    """What decides a checkpoint's windows: the network and its weights, the frames, the code."""
    return {  # frames at once are the stage's
        "stage": folder.key,
        "weights": read_marker(folder, step).sha256,
        "frames": sweep.frames_digest,
        "most": [POSITIVES, NEGATIVES],
        "code": code_digest(*CODE),
    }


def _run(sweep: FinishedSweep, places: Sequence[Place], whole: Collection[Place]) -> list[Windows]:
    spec = read_spec(places[0][0])
    device = (
        spec.machine.device if torch.cuda.is_available() else "cpu"
    )  # trained elsewhere, perhaps
    frames = Frames(spec.kitti(sweep.kitti().root), spec.machine.val_ids, spec.machine.cache_frames)
    detectors = [_load(folder, step, device) for folder, step in places]
    with multiplying(spec.settings.precision, device):
        return collect_windows(
            detectors,
            frames,
            device,
            spec.settings.batch_size,
            with_negatives=[place in whole for place in places],
        )


def _load(folder: RunFolder, step: int, device: str) -> Detector:
    """A checkpoint's network, of the weights that its marker names: what is kept of it bears their digest.

    Raises:
        CheckpointError: the weights cannot be read, or are others.
    """
    detector = load(folder, step, device)
    weights = folder.weights(step)
    if file_digest(weights) != read_marker(folder, step).sha256:
        raise CheckpointError(f"{weights}: is not what its marker says; it was changed since")
    return detector


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
            positives[place].append(_numbers(positive))
            if wanted[place]:
                rng = copy.deepcopy(generators[0])
                negatives[place].append(_sample(_numbers(negative), limit * len(own), rng))
    return [
        Windows(
            _sample(np.concatenate(met), most_positive, np.random.default_rng(0)),
            np.concatenate(others or [np.zeros(0, dtype=np.float32)]),
            len(frames),
        )
        for met, others in zip(positives, negatives, strict=True)
    ]


def _numbers(logits: torch.Tensor) -> NDArray[np.float32]:
    found: NDArray[np.float32] = logits.float().cpu().numpy()
    return found


def _sample(
    values: NDArray[np.float32], limit: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    return values if len(values) <= limit else rng.choice(values, limit, replace=False)
