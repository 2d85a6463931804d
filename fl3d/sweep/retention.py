"""Keep the disk: of each stage the weights of the last, the best and every k-th checkpoint; everything else stays.

Markers, detections and scores of all checkpoints are kept: they are small, and every table and figure is made of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fl3d.records import Stage
from fl3d.reports.selection import MEAN_3D
from fl3d.sweep.scoreboard import Scoreboard


def kept_epochs(epochs: Sequence[int], means: Mapping[int, float], every: int | None) -> set[int]:
    """Epochs of a finished stage whose weights are kept. Pure.

    Args:
        epochs: of its checkpoints, rising.
        means: mean 3D AP at each; the earliest of the highest is the best.
        every: keep each epoch that this number divides; None: only the last and the best.
    """
    best = max(epochs, key=lambda epoch: (means[epoch], -epoch))
    return {epochs[-1], best} | {epoch for epoch in epochs if every and epoch % every == 0}


def superfluous_weights(stage: Stage, scores: Scoreboard, every: int | None) -> list[Path]:
    """Weights files of a finished stage that the rule does not keep."""
    curve = scores.curve(stage)
    means = {epoch: sum(aps[key] for key in MEAN_3D) for epoch, aps in curve.items()}
    kept = kept_epochs(sorted(curve), means, every)
    paths = scores.paths(stage.key)
    steps = [stage.start_step + epoch * stage.epoch_steps for epoch in sorted(set(curve) - kept)]
    return [path for path in map(paths.weights, steps) if path.exists()]


def size(paths: Iterable[Path]) -> int:
    """Bytes of files."""
    return sum(path.stat().st_size for path in paths)
