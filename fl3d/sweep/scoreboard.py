"""The scores of checkpoints on disk under one protocol: made where they are missing, read once."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable

from fl3d.core.errors import CheckpointError, DataError
from fl3d.core.records import Stage
from fl3d.evaluation.detections import Validation
from fl3d.evaluation.protocol import Protocol
from fl3d.inference.scores import scores_of
from fl3d.runs.layout import RunFolder, StoreFolder

APs = dict[str, float]


class Scoreboard:
    """Scores of all stages of a store folder.

    Args:
        layout: of the store folder.
        validation: frames that scores are on.
        protocol: of the scores.
    """

    def __init__(self, layout: StoreFolder, validation: Validation, protocol: Protocol) -> None:
        self.layout = layout
        self.validation = validation
        self.protocol = protocol
        self._read: dict[tuple[str, int], APs] = {}
        self._steps: dict[str, tuple[int, list[int]]] = {}
        self._told: dict[str, int] = {}

    def folder(self, key: str) -> RunFolder:
        """Run folder of a stage."""
        return self.layout.run(key)

    def steps(self, key: str) -> list[int]:
        """Steps of a stage's checkpoints; its folder is listed again only when it has changed."""
        folder = self.folder(key)
        try:
            changed = folder.marker(0).parent.stat().st_mtime_ns
        except FileNotFoundError:
            return []
        if self._steps.get(key, (-1, []))[0] != changed:
            self._steps[key] = (changed, folder.steps())
        return self._steps[key][1]

    def changed(self, keys: Iterable[str]) -> set[str]:
        """Stages among some that have other checkpoints than when this was asked last."""
        steps = {key: len(self.steps(key)) for key in keys}
        found = {key for key, count in steps.items() if count != self._told.get(key, 0)}
        self._told |= steps
        return found

    def aps(self, key: str, step: int) -> APs:
        """APs of a stage's checkpoint, such as ``ap_3d/moderate``, in percent."""
        if (key, step) not in self._read:
            self._read[key, step] = scores_of(
                self.folder(key), step, self.validation, self.protocol
            )
        return self._read[key, step]

    def curve(self, stage: Stage) -> dict[int, APs]:
        """APs of a stage's checkpoints so far, by its own epochs; those that cannot be read are left out."""
        found = {}
        for step in self.steps(stage.key):
            with contextlib.suppress(CheckpointError, DataError):  # the recorder says so, once
                found[stage.own_epoch(step)] = self.aps(stage.key, step)
        return found
