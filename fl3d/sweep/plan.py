"""Trials that begin alike share their first stages: from configs to a tree of stages. Pure."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, options
from fl3d.core.names import LONGEST, check_name
from fl3d.core.records import Config, Stage, Trial, detector_label
from fl3d.sweep.identity import hashed, of_command_stage, result_config, stable_name, targets
from fl3d.training.command import is_command

# Raised when the same stage gets another key. 2: classes are hashed by stable names, not by import paths.
KEY_VERSION = 2


@dataclass(frozen=True)
class DataInfo:
    """What a plan must know of the data.

    Args:
        digest: of all frames.
        n_train: number of training frames.
        image_digest: of what a 2D detector found in them; None where none was run.
    """

    digest: str
    n_train: int
    image_digest: str | None = None


@dataclass(frozen=True)
class DetectorInfo:
    """What a plan must know of a detector.

    Args:
        name: as the papers write it.
        version: part of a stage's identity.
        stages: that it can be trained in.
    """

    name: str
    version: object
    stages: Sequence[str]


@dataclass(frozen=True)
class Plan:
    """A sweep, ready to run.

    Args:
        sweep: name of the experiment.
        trials: in the sweeper's order; equal ones once.
        stages: by key, parents before children.
    """

    sweep: str
    trials: tuple[Trial, ...]
    stages: Mapping[str, Stage]

    @property
    def epochs(self) -> int:
        """Epochs to train when beginnings are shared."""
        return sum(stage.epochs for stage in self.stages.values())

    @property
    def plain_epochs(self) -> int:
        """Epochs to train when every trial starts from scratch."""
        return sum(self.stages[key].epochs for trial in self.trials for key in trial.stages)

    def joined(self, other: Plan) -> Plan:
        """This plan and the trials and stages of another that it lacks, behind its own."""
        known = {trial.key for trial in self.trials}
        trials = (*self.trials, *(trial for trial in other.trials if trial.key not in known))
        stages = {key: stage for key, stage in other.stages.items() if key not in self.stages}
        return Plan(self.sweep, trials, {**self.stages, **stages})


def trial_stages(
    config: Config, data: DataInfo, trainer_version: int, detector: DetectorInfo
) -> list[Stage]:
    """The stages of one trial, first to last.

    Args:
        config: of the trial, resolved.
        data: identity and size of the data.
        trainer_version: of the trainer.
        detector: of the config's detector.

    Raises:
        ConfigError: the schedule names a stage that the detector does not offer, or a count below one; no folder can
            have the name of the stage, or the detector's.
    """
    _check_counts(config["schedule"])
    if len(_in_keys(config)) > LONGEST:
        raise ConfigError(
            f"detector.name: '{detector.name[:LONGEST]}...' is too long for the name of a folder: at most {LONGEST} "
            "letters"
        )
    chain: list[Stage] = []
    for name, own in config["schedule"]["stages"].items():
        if own is None:  # left out
            continue
        if name not in detector.stages:
            raise ConfigError(
                f"schedule.stages: {detector.name} has no stage '{name}'. {options(name, detector.stages)}"
            )
        check_name("schedule.stages", name)
        chain.append(
            _stage(
                config,
                name,
                chain[-1] if chain else None,
                data,
                [trainer_version, detector.version],
            )
        )
    if not chain:
        raise ConfigError("schedule.stages: a trial needs at least one stage")
    return chain


def _stage(
    config: Config, name: str, parent: Stage | None, data: DataInfo, versions: Sequence[object]
) -> Stage:
    stage_config = configure_stage(config, name, has_parent=parent is not None)
    return Stage(
        key=stage_key(stage_config, name, parent, data, versions),
        name=name,
        config=stage_config,
        parent=parent.key if parent else None,
        start_epoch=parent.start_epoch + parent.epochs if parent else 0,
        start_step=parent.end_step if parent else 0,
        epochs=config["schedule"]["stages"][name]["epochs"],
        # What a command does within an epoch is its own.
        epoch_steps=1
        if is_command(config)
        else _epoch_steps(stage_config["schedule"], data.n_train),
    )


def check_names(configs: Sequence[Config]) -> None:
    """Refuse two classes that identity could not tell apart.

    Raises:
        ConfigError: naming both.
    """
    seen: dict[str, str] = {}
    for config in configs:
        for target in targets(result_config(config)):
            other = seen.setdefault(stable_name(target), target)
            if other != target:
                raise ConfigError(
                    f"_target_: {other} and {target} have one name and one package; rename one of them"
                )


def _check_counts(schedule: Mapping[str, Any]) -> None:
    """Refuse counts below one."""
    counts = {key: schedule[key] for key in ("batch_size", "checkpoint_every", "frames_per_epoch")}
    counts |= {
        f"stages.{name}.epochs": own.get("epochs")
        for name, own in schedule["stages"].items()
        if own
    }
    for key, count in counts.items():
        may_be_null = key == "frames_per_epoch"
        if count is None and may_be_null:
            continue
        if not isinstance(count, int) or count < 1:
            raise ConfigError(f"schedule.{key}: {count} is not a whole number of at least 1")


def _epoch_steps(schedule: Mapping[str, Any], n_train: int) -> int:
    return math.ceil((schedule["frames_per_epoch"] or n_train) / schedule["batch_size"])


def configure_stage(config: Config, name: str, has_parent: bool = False) -> Config:
    """The config that one stage is trained under: the trial's, with the stage's own changes (``set``)."""
    merged = with_stage(result_config(config), config, name)
    if not is_command(config):
        return merged
    return of_command_stage(merged, with_stage(config, config, name), has_parent)


def with_stage(part: Config, config: Config, name: str) -> Config:
    """A config, or a part of it, with the changes of one of its stages."""
    own = config["schedule"]["stages"][name]
    merged = _merge(part, own.get("set") or {})
    schedule = dict(merged["schedule"])
    del schedule["stages"]
    schedule["stage"] = {"epochs": own["epochs"], "lr_factor": own.get("lr_factor", 1.0)}
    return {**merged, "schedule": schedule}


def stage_key(
    config: Config, name: str, parent: Stage | None, data: DataInfo, versions: Sequence[object]
) -> str:
    """Readable identity: detector, stage, and a hash of the config, the parent, the data and the versions."""
    content: dict[str, Any] = {
        "keys": KEY_VERSION,
        "config": hashed(config),
        "parent": parent.key if parent else None,
        "data": data.digest,
        "versions": list(versions),
    }
    return sys.intern(f"{_in_keys(config)}-{name}-{digest(content)[:10]}")  # each is named often


def _in_keys(config: Config) -> str:
    """What a detector is called in the keys of its stages."""
    return re.sub(r"[^a-z0-9]+", "_", detector_label(config).lower())


def longest_paths(plan: Plan, seconds: Mapping[str, float]) -> dict[str, float]:
    """Time on the longest path from each stage to a leaf, itself included; stages without an entry take none."""
    longest = {key: seconds.get(key, 0.0) for key in plan.stages}
    below = dict.fromkeys(plan.stages, 0.0)
    for key, stage in reversed(list(plan.stages.items())):
        longest[key] += below[key]
        if stage.parent is not None:
            below[stage.parent] = max(below[stage.parent], longest[key])
    return longest


def _merge(base: Config, changes: Mapping[str, Any]) -> Config:
    """A config with changes; what is not changed is shared, for configs are never written to."""
    merged = dict(base)
    for key, value in changes.items():
        before = merged.get(key)
        if isinstance(value, Mapping) and isinstance(before, dict):
            merged[key] = _merge(before, value)
        else:
            merged[key] = value
    return merged
