"""What makes a stage the stage it is: each config key can change a result, or is named as one that cannot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from fl3d.core.records import Config

# Keys that can change the weights, the detections or the scores' steps of a stage.
RESULT = (
    "detector.*",
    "augment",
    "augment.*",
    "loss.*",
    "optimizer.*",
    "schedule.batch_size",
    "schedule.frames_per_epoch",
    "schedule.clip",
    "schedule.ramp_steps",
    "schedule.checkpoint_every",
    "schedule.one_cycle",
    "schedule.one_cycle.*",
    "schedule.decay",
    "schedule.decay.*",
    "schedule.stages.*",
    "data.crop",
    "data.calibration",
    "data.cloud.*",
    "data.image_size",
    "detections.*",
    "seed",
    "precision",
    "compile",
)
# Of these, keys that came when results were there already: they enter where they are not what all had before.
USUAL = {
    "data.cloud.columns": None,
    "data.cloud.dtype": None,
    "data.cloud.reflectance_scale": 1,
    "data.image_size": None,
}
# Keys that cannot. The frames themselves enter through the data's digest; scores carry their protocol's identity.
BOOKKEEPING = (
    "data.name",
    "data.root",
    "data.generate",
    "data.seed",
    "data.train_split",
    "data.val_split",
    "data.train_frames",
    "data.val_frames",
    "data.cache_frames",
    "data.mapping",
    "profile.*",
    "protocol.*",
    "schedule.save_every_steps",
    "schedule.epochs.*",  # what the stages' own epochs are read from
    "sweep.*",
    "selection.*",
    "store.*",
    "results",
    "device",
    "workers",
)


def leaves(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a nested config; an empty mapping is a leaf."""
    for key, value in config.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{name}.")
        else:
            yield name, value


def matches(key: str, patterns: tuple[str, ...]) -> bool:
    """Whether a dotted key is named by any of the patterns."""
    return any(fnmatchcase(key, pattern) for pattern in patterns)


def result_config(config: Config) -> Config:
    """The part of a config that can change a result."""
    kept: Config = {}
    for key, value in leaves(config):
        if matches(key, RESULT) and not (key in USUAL and value == USUAL[key]):
            node = kept
            *parents, last = key.split(".")
            for part in parents:
                node = node.setdefault(part, {})
            node[last] = value
    return kept


def stable_name(target: str) -> str:
    """What identity calls a class: its package and its name, whatever module it lies in: ``fl3d:VoxelNet``."""
    package = target.partition(".")[0]
    return f"{package}:{target.rpartition('.')[2]}"


def with_stable_names(value: Any) -> Any:
    """A config whose ``_target_`` are stable names, so that a class that moves within its package retrains nothing."""
    if isinstance(value, Mapping):
        return {
            key: stable_name(item) if key == "_target_" else with_stable_names(item)
            for key, item in value.items()
        }
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [with_stable_names(item) for item in value]
    return value


def targets(value: Any) -> Iterator[str]:
    """Every ``_target_`` in a config."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key == "_target_":
                yield str(item)
            else:
                yield from targets(item)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from targets(item)
