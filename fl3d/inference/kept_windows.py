"""Windows of checkpoints as they are kept beside them, and made where they are not."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fl3d.core.digests import digest, file_digest
from fl3d.core.errors import CheckpointError
from fl3d.data.dataset import Frames
from fl3d.detectors.base import Detector
from fl3d.inference.load import load
from fl3d.inference.precision import multiplying
from fl3d.inference.windows import NEGATIVES, POSITIVES, Windows, collect_windows
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, is_kept, kept
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec

# What their values come from, besides weights and frames.
CODE = ("geometry", "data", "losses.py", "sparse", "points", "detectors", "inference")
Place = tuple[RunFolder, int]  # of a checkpoint: the stage that holds it, and its step


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


def keep_positives(
    folder: RunFolder, step: int, weights: str, frames: str, positives: NDArray[np.float32]
) -> None:
    """Keep what ``positives_of`` will ask for, as a checkpoint is made.

    Args:
        folder: of its stage.
        step: of it.
        weights: SHA-256 of its weights.
        frames: ``frame_digests.input_digest`` of the validation frames.
        positives: (P,) as ``sampled_positives`` gives them.
    """
    own = _made_of(folder, weights, frames)
    kept(folder.kept(step, "positives"), own, lambda: {"positive": positives})


def made_of(sweep: FinishedSweep, folder: RunFolder, step: int) -> Mapping[str, Any]:
    """What decides a checkpoint's windows: the network and its weights, the frames, the code."""
    return _made_of(folder, read_marker(folder, step).sha256, sweep.frames_digest)


def _made_of(folder: RunFolder, weights: str, frames: str) -> Mapping[str, Any]:
    return {  # frames at once are the stage's
        "stage": folder.key,
        "weights": weights,
        "frames": frames,
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
