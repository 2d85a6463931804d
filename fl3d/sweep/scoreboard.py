"""The scores of checkpoints on disk under one protocol: made where they are missing, read once."""

from __future__ import annotations

import json
from pathlib import Path

from fl3d.evaluation.detections import Validation
from fl3d.evaluation.protocol import Protocol
from fl3d.records import Stage, StagePaths
from fl3d.training.run import write_scores

APs = dict[str, float]


class Scoreboard:
    """Scores of all stages below a folder.

    Args:
        stages_root: the folder.
        validation: frames that scores are on.
        protocol: of the scores.
    """

    def __init__(self, stages_root: Path, validation: Validation, protocol: Protocol) -> None:
        self.stages_root, self.validation, self.protocol = stages_root, validation, protocol
        self._read: dict[tuple[str, int], APs] = {}
        self._steps: dict[str, tuple[int, list[int]]] = {}

    def paths(self, key: str) -> StagePaths:
        """Files of a stage."""
        return StagePaths(self.stages_root / key)

    def steps(self, key: str) -> list[int]:
        """Steps of a stage's checkpoints; its folder is listed again only when it has changed."""
        paths = self.paths(key)
        try:
            changed = paths.marker(0).parent.stat().st_mtime_ns
        except FileNotFoundError:
            return []
        if self._steps.get(key, (-1, []))[0] != changed:
            self._steps[key] = changed, paths.steps()
        return self._steps[key][1]

    def aps(self, key: str, step: int) -> APs:
        """APs of a stage's checkpoint, such as ``ap_3d/moderate``, in percent."""
        if (key, step) not in self._read:
            paths = self.paths(key)
            write_scores(paths, step, self.validation, self.protocol)
            self._read[key, step] = json.loads(paths.scores(step, self.protocol.id).read_text())
        return self._read[key, step]

    def curve(self, stage: Stage) -> dict[int, APs]:
        """APs of a stage's checkpoints so far, by its own epochs."""
        steps = self.steps(stage.key)
        return {(step - stage.start_step) // stage.epoch_steps: self.aps(stage.key, step) for step in steps}
