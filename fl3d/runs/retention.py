"""Keep the disk: of each stage the weights of the last, the best and every k-th checkpoint; everything else stays.

Markers, detections and scores of all checkpoints are kept: they are small, and every table and figure is made of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fl3d.evaluation.selection import MEAN_3D
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import read_scores, read_spec


def kept_epochs(
    epochs: Sequence[int], means: Iterable[Mapping[int, float]], every: Iterable[int | None]
) -> set[int]:
    """Epochs of a finished stage whose weights are kept. Pure.

    Args:
        epochs: of its checkpoints, rising.
        means: mean 3D AP at each, under each protocol it was scored with; the earliest of the highest is the best.
        every: numbers asked for: each epoch that one of them divides is kept; None: only the last and the best.
    """
    best = {max(own, key=lambda epoch: (own[epoch], -epoch)) for own in means}
    divided = {epoch for epoch in epochs for number in every if number and epoch % number == 0}
    return {epochs[-1]} | best | divided


def superfluous_weights(folder: RunFolder, every: int | None) -> list[Path]:
    """Weights files of a finished stage that the rule does not keep.

    Args:
        folder: of the stage.
        every: asked for now; what was asked for when it was trained counts too.
    """
    spec = read_spec(folder)
    steps = {spec.stage.own_epoch(step): step for step in folder.steps()}
    if not steps:
        return []  # deleted, or listed late
    means = [
        {epoch: _mean(folder, step, protocol) for epoch, step in steps.items()}
        for protocol in folder.protocols()
    ]
    kept = kept_epochs(sorted(steps), means, (every, spec.machine.keep_every))
    files = [folder.weights(step) for epoch, step in sorted(steps.items()) if epoch not in kept]
    return [file for file in files if file.exists()]


class Tidy:
    """Deletes weights that nobody needs of stages that are done, each stage once.

    Args:
        layout: of the store folder.
        every: see ``superfluous_weights``.
    """

    def __init__(self, layout: StoreFolder, every: int | None) -> None:
        self.layout = layout
        self.every = every
        self._tidied: set[str] = set()

    def stages(self, done: Iterable[str]) -> None:
        """Tidy the stages that are new among those that are done."""
        for key in set(done) - self._tidied:
            self._tidied.add(key)
            for path in superfluous_weights(self.layout.run(key), self.every):
                path.unlink(missing_ok=True)


def _mean(folder: RunFolder, step: int, protocol: str) -> float:
    """Sum of the 3D APs; a checkpoint that was not scored under the protocol is not its best."""
    aps = read_scores(folder, step, protocol)
    return float(sum(aps[key] for key in MEAN_3D)) if aps is not None else -1.0
