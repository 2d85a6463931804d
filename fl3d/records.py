"""Records that the rooms hand to each other. All frozen, all plain: they can be written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Config = dict[str, Any]


@dataclass(frozen=True)
class Stage:
    """One stretch of training under one config.

    Args:
        key: readable identity, ``voxelnet-warmup-3fa9c1d2``: detector, stage, hash of all that can change it.
        name: of the stage, such as ``warmup``.
        config: what is trained, resolved; only keys that can change a result.
        parent: key of the stage it goes on from, or None.
        start_epoch: epochs trained before it by its ancestors.
        start_step: optimiser steps trained before it by its ancestors.
        epochs: of its own.
        epoch_steps: steps in one of its epochs.
    """

    key: str
    name: str
    config: Config
    parent: str | None
    start_epoch: int
    start_step: int
    epochs: int
    epoch_steps: int

    @property
    def steps(self) -> int:
        """Steps of its own."""
        return self.epochs * self.epoch_steps

    @property
    def end_step(self) -> int:
        """Step of its last checkpoint."""
        return self.start_step + self.steps


@dataclass(frozen=True)
class Trial:
    """One point of a sweep.

    Args:
        key: of its last stage, which is its identity.
        overrides: what makes it differ from the other trials, as the user wrote it.
        config: fully resolved.
        stages: keys, first to last.
    """

    key: str
    overrides: tuple[str, ...]
    config: Config
    stages: tuple[str, ...]


@dataclass(frozen=True)
class Checkpoint:
    """A stage at one step, as its marker file tells it.

    Args:
        stage: key.
        step: since the beginning of the first stage.
        epoch: completed, since the beginning of the first stage.
        lr: learning rate of the last step.
        losses: mean of each loss term since the checkpoint before.
        seconds: of training since the checkpoint before, and of detection and scoring.
        sha256: of the weights file.
        detections_sha256: of the detections file.
        time_ms: when it was made, milliseconds since 1970.
        made_by: commit, versions and machine, see ``provenance``.
    """

    stage: str
    step: int
    epoch: int
    lr: float
    losses: Mapping[str, float]
    seconds: Mapping[str, float]
    sha256: str
    detections_sha256: str = ""
    time_ms: int = 0
    made_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class StagePaths:
    """The files of a stage; nobody else joins these names.

    Args:
        folder: ``runs/stages/<key>``.
    """

    folder: Path

    @property
    def spec(self) -> Path:
        """The stage and the machine-dependent settings it was last started with."""
        return self.folder / "stage.json"

    @property
    def done(self) -> Path:
        """Marker, written last."""
        return self.folder / "done.json"

    @property
    def progress(self) -> Path:
        """Step reached, renewed every second or so."""
        return self.folder / "progress.json"

    @property
    def lease(self) -> Path:
        """Held by the process that trains it, see ``leases``."""
        return self.folder / "lease.json"

    @property
    def error(self) -> Path:
        """Traceback of the last failure."""
        return self.folder / "error.txt"

    def weights(self, step: int) -> Path:
        """Weights, optimiser, generators and position."""
        return self.folder / "checkpoints" / f"{step:08d}.pt"

    def marker(self, step: int) -> Path:
        """A ``Checkpoint``; the checkpoint exists when this does."""
        return self.folder / "checkpoints" / f"{step:08d}.json"

    @property
    def resume(self) -> Path:
        """A resume point between two checkpoints."""
        return self.folder / "resume.pt"

    def detections(self, step: int) -> Path:
        """What a checkpoint predicts on the validation frames."""
        return self.folder / "detections" / f"{step:08d}.parquet"

    def scores(self, step: int, protocol_id: str) -> Path:
        """AP of a checkpoint under a protocol."""
        return self.folder / "scores" / protocol_id / f"{step:08d}.json"

    def steps(self) -> list[int]:
        """Steps of the checkpoints that exist, rising."""
        return sorted(int(p.stem) for p in (self.folder / "checkpoints").glob("*.json") if p.stem.isdigit())
