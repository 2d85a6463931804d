"""Records that the rooms hand to each other. All frozen, all plain: they can be written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Config = dict[str, Any]


def detector_label(config: Mapping[str, Any]) -> str:
    """What files and trees call a config's detector: its name where a command trains it, else its class."""
    section = config["detector"]
    return str(section.get("name") or section["_target_"].rpartition(".")[2])


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One stretch of training under one config.

    Args:
        key: readable identity, ``voxelnet-warmup-3fa9c1d2``: detector, stage, hash of all that can change it.
        name: of the stage, such as ``warmup``.
        config: what is trained, resolved; only keys that can change a result.
        parent: key of the stage it resumes from, or None.
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

    @property
    def target(self) -> str:
        """Import path of its detector's class."""
        return str(self.config["detector"]["_target_"])

    @property
    def class_name(self) -> str:
        """Name of its detector's class, or of the program that trains it."""
        return detector_label(self.config)

    def own_epoch(self, step: int) -> int:
        """Epochs of its own that a checkpoint at a step has behind it."""
        return (step - self.start_step) // self.epoch_steps


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One point of a sweep, and its place in the sweep's design.

    Args:
        key: of its last stage, which is its identity.
        overrides: what makes it differ from the other trials, as the user wrote it.
        values: swept values by key, as data.
        config: fully resolved.
        stages: keys, first to last.
        first_own_step: step at which its last stage begins.
        detector: as the papers write it.
        group: label of what it shares with the trials that it is compared with.
        level: label of its value of the factor.
        seed: of its training.
    """

    key: str
    overrides: tuple[str, ...]
    values: Mapping[str, Any]
    config: Config
    stages: tuple[str, ...]
    first_own_step: int
    detector: str
    group: str
    level: str
    seed: int

    @property
    def label(self) -> str:
        """What a person calls it."""
        return f"{self.group} {self.level} seed {self.seed}"


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A stage at one step, as its marker file tells it.

    Args:
        stage: key.
        step: since the beginning of the first stage.
        epoch: completed, since the beginning of the first stage.
        lr: learning rate of the last step; None: a command does not tell it.
        losses: mean of each loss term since the checkpoint before.
        seconds: of training since the checkpoint before, and of detection and scoring.
        sha256: of the weights file; empty where a command keeps its own.
        detections_sha256: of the detections file.
        time_ms: when it was made, milliseconds since 1970.
        made_by: commit, versions and machine, see ``provenance``.
    """

    stage: str
    step: int
    epoch: int
    lr: float | None
    losses: Mapping[str, float]
    seconds: Mapping[str, float]
    sha256: str
    detections_sha256: str = ""
    time_ms: int = 0
    made_by: Mapping[str, str] = field(default_factory=dict)

    @property
    def commit(self) -> str:
        """Of fl3d when it was made; ``unknown`` where there was no git."""
        return self.made_by.get("fl3d.commit", "unknown")
