"""Keep the disk: of each stage the weights of the last, the best and every k-th checkpoint; everything else stays.

Markers, detections and scores of all checkpoints are kept: they are small, and every table and figure is made of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fl3d.records import Stage, StagePaths
from fl3d.reports.selection import MEAN_3D


def kept_epochs(epochs: Sequence[int], means: Iterable[Mapping[int, float]], every: Iterable[int | None]) -> set[int]:
    """Epochs of a finished stage whose weights are kept. Pure.

    Args:
        epochs: of its checkpoints, rising.
        means: mean 3D AP at each, under each protocol it was scored with; the earliest of the highest is the best.
        every: numbers asked for: each epoch that one of them divides is kept; None: only the last and the best.
    """
    best = {max(own, key=lambda epoch: (own[epoch], -epoch)) for own in means}
    divided = {epoch for epoch in epochs for number in every if number and epoch % number == 0}
    return {epochs[-1]} | best | divided


def superfluous_weights(paths: StagePaths, stage: Stage, every: int | None) -> list[Path]:
    """Weights files of a finished stage that the rule does not keep.

    Args:
        paths: of the stage.
        stage: the stage.
        every: asked for now; what was asked for when it was trained counts too.
    """
    asked = json.loads(paths.spec.read_text())["machine"].get("keep_every")
    steps = {(step - stage.start_step) // stage.epoch_steps: step for step in paths.steps()}
    protocols = [folder for folder in (paths.folder / "scores").glob("*") if folder.is_dir()]
    means = [{epoch: _mean(paths, step, own.name) for epoch, step in steps.items()} for own in protocols]
    kept = kept_epochs(sorted(steps), means, (every, asked))
    files = [paths.weights(step) for epoch, step in sorted(steps.items()) if epoch not in kept]
    return [file for file in files if file.exists()]


def _mean(paths: StagePaths, step: int, protocol: str) -> float:
    """Sum of the 3D APs; a checkpoint that was not scored under the protocol is not its best."""
    path = paths.scores(step, protocol)
    if not path.exists():
        return -1.0
    aps = json.loads(path.read_text())
    return float(sum(aps[key] for key in MEAN_3D))
