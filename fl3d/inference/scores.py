"""Scores of stored detections, kept beside them."""

from __future__ import annotations

from pathlib import Path

from fl3d.data.dataset import Frames
from fl3d.evaluation.detections import Detections, read_detections
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.scoring import score
from fl3d.evaluation.validation import Validation
from fl3d.inference.detect import detect_frames
from fl3d.inference.load import load
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_scores, read_spec, write_scores


def scores_of(
    folder: RunFolder, step: int, validation: Validation, protocol: Protocol
) -> dict[str, float]:
    """Scores of a checkpoint's stored detections: read, or made and kept.

    Args:
        folder: of its stage.
        step: of the checkpoint.
        validation: the frames.
        protocol: what an AP stands for.
    """
    kept = read_scores(folder, step, protocol.id)
    if kept is not None:
        return kept
    scores = score(read_detections(folder.detections(step)), validation, protocol)
    write_scores(folder, step, protocol, scores)
    return scores


def detect_again(folder: RunFolder, step: int, data: Path | None = None) -> Detections:
    """What a checkpoint's weights predict on the validation frames now.

    Args:
        folder: of its stage.
        step: of the checkpoint.
        data: folder of the frames; None: where they lay when the stage was started.

    Raises:
        CheckpointError: the weights cannot be read.
        DataError: the frames are not there.
    """
    spec = read_spec(folder)
    settings = spec.settings
    return detect_frames(
        load(folder, step, spec.machine.device),
        Frames(spec.kitti(data), spec.machine.val_ids, 0),
        settings.max_boxes,
        settings.min_score,
        spec.machine.device,
        settings.precision,
        settings.batch_size,  # rounding differs with it
    )
