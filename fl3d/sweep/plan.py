"""Trials that begin alike share their first stages: from configs to a tree of stages. Pure."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fl3d.digests import digest
from fl3d.errors import ConfigError, options
from fl3d.records import Config, Stage, Trial
from fl3d.sweep.identity import result_config, stable_name, targets, with_stable_names

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
class Plan:
    """A sweep, ready to run.

    Args:
        sweep: its name.
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
        """Epochs to train when every trial starts from nothing."""
        return sum(self.stages[key].epochs for trial in self.trials for key in trial.stages)

    def joined(self, other: Plan) -> Plan:
        """This plan and the trials and stages of another that it lacks, behind its own."""
        known = {trial.key for trial in self.trials}
        trials = (*self.trials, *(trial for trial in other.trials if trial.key not in known))
        stages = {key: stage for key, stage in other.stages.items() if key not in self.stages}
        return Plan(self.sweep, trials, {**self.stages, **stages})


def make_plan(
    sweep: str,
    configs: Sequence[tuple[Sequence[str], Config]],
    data: DataInfo,
    versions: Mapping[str, object],
    known_stages: Mapping[str, Sequence[str]],
) -> Plan:
    """Lay out the stages of trials.

    Args:
        sweep: its name.
        configs: each trial's overrides and resolved config.
        data: identity and size of the data.
        versions: of trainer and detectors, by ``_target_``; see ``stage_key``.
        known_stages: stages that each detector offers, by ``_target_``.

    Raises:
        ConfigError: a schedule names a stage that the detector does not offer, or two classes share a stable name.
    """
    _check_names([config for _, config in configs])
    stages: dict[str, Stage] = {}
    trials: dict[str, Trial] = {}
    for overrides, config in configs:
        chain = trial_stages(config, data, versions, known_stages)
        stages |= {stage.key: stage for stage in chain}
        trial = Trial(chain[-1].key, tuple(overrides), config, tuple(stage.key for stage in chain))
        trials.setdefault(trial.key, trial)
    return Plan(sweep, tuple(trials.values()), stages)


def trial_stages(
    config: Config, data: DataInfo, versions: Mapping[str, object], known_stages: Mapping[str, Sequence[str]]
) -> list[Stage]:
    """The stages of one trial, first to last."""
    target = config["detector"]["_target_"]
    _check_counts(config["schedule"])
    chain: list[Stage] = []
    for name, own in config["schedule"]["stages"].items():
        if own is None:  # left out
            continue
        if name not in known_stages[target]:
            raise ConfigError(f"schedule.stages: {target} has no stage '{name}'. {options(name, known_stages[target])}")
        stage_config = configure_stage(config, name)
        parent = chain[-1] if chain else None
        key = stage_key(stage_config, name, parent, data, versions)
        epoch, step = (parent.start_epoch + parent.epochs, parent.end_step) if parent else (0, 0)
        above = parent.key if parent else None
        epoch_steps = _epoch_steps(stage_config["schedule"], data.n_train)
        chain.append(Stage(key, name, stage_config, above, epoch, step, own["epochs"], epoch_steps))
    if not chain:
        raise ConfigError("schedule.stages: a trial needs at least one stage")
    return chain


def _check_names(configs: Sequence[Config]) -> None:
    """Refuse two classes that identity could not tell apart."""
    seen: dict[str, str] = {}
    for config in configs:
        for target in targets(result_config(config)):
            other = seen.setdefault(stable_name(target), target)
            if other != target:
                raise ConfigError(f"_target_: {other} and {target} have one name and one package; rename one of them")


def _check_counts(schedule: Mapping[str, Any]) -> None:
    """Refuse counts below one."""
    counts = {key: schedule[key] for key in ("batch_size", "checkpoint_every", "frames_per_epoch")}
    counts |= {f"stages.{name}.epochs": own.get("epochs") for name, own in schedule["stages"].items() if own}
    for key, count in counts.items():
        if (count is None and key != "frames_per_epoch") or (
            count is not None and not (isinstance(count, int) and count >= 1)
        ):
            raise ConfigError(f"schedule.{key}: {count} is not a whole number of at least 1")


def _epoch_steps(schedule: Mapping[str, Any], n_train: int) -> int:
    return math.ceil((schedule["frames_per_epoch"] or n_train) / schedule["batch_size"])


def configure_stage(config: Config, name: str) -> Config:
    """The config that one stage is trained under: the trial's, with the stage's own changes (``set``)."""
    own = config["schedule"]["stages"][name]
    merged = _merge(result_config(config), own.get("set") or {})
    schedule = dict(merged["schedule"])
    del schedule["stages"]
    schedule["stage"] = {"epochs": own["epochs"], "lr_factor": own["lr_factor"]}
    return {**merged, "schedule": schedule}


def stage_key(config: Config, name: str, parent: Stage | None, data: DataInfo, versions: Mapping[str, object]) -> str:
    """Readable identity: detector, stage, and a hash of the config, the parent, the data and the versions."""
    target = config["detector"]["_target_"]
    content: dict[str, Any] = {
        "keys": KEY_VERSION,
        "config": with_stable_names(config),
        "parent": parent.key if parent else None,
        "data": data.digest,
        "versions": [versions["trainer"], versions[target]],
    }
    return f"{target.rsplit('.', 1)[-1].lower()}-{name}-{digest(content)[:10]}"


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
    merged = copy.deepcopy(base)
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _merge(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged
