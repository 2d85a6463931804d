"""What makes a stage the stage it is: each config key can change a result, or is named as one that cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from typing import Any

from fl3d.core.nested import has_key, leaves, value_at
from fl3d.core.records import Config
from fl3d.training.command import (
    command_of,
    is_command,
    places_of,
    reading_part,
    trained_part,
)
from fl3d.training.templates import names_in

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
    "classes",
)
# Of these, keys that came when results were there already: they enter where they are not what all had before.
USUAL = {
    "data.cloud.columns": None,
    "data.cloud.dtype": None,
    "data.cloud.reflectance_scale": 1,
    "data.image_size": None,
    "classes": ["Car"],
    "detector.per_class": None,
    "detector.middle_kernel": "cube",
    "detector.slabs_used": None,
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
    "data.people",
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
# Keys of a detector that a command trains, besides those that the command names: the section itself, what its stages
# are, and what its frames are read by.
FRAMES = ("data.crop", "data.calibration", "data.cloud.*", "data.image_size")
COMMAND_RESULT = ("detector.*", "schedule.stages.*", *FRAMES)


@cache  # a sweep of 10,000 trials asks for the same few keys
def matches(key: str, patterns: tuple[str, ...]) -> bool:
    """Whether a dotted key is named by any of the patterns."""
    return any(fnmatchcase(key, pattern) for pattern in patterns)


def result_config(config: Config) -> Config:
    """The part of a config that can change a result; of a command's what it names, and nothing else."""
    if not is_command(config):
        return _kept(config, lambda key: matches(key, RESULT))
    named = [name for name in places_of(config) if not matches(name, BOOKKEEPING)]
    return _kept(config, lambda key: matches(key, COMMAND_RESULT) or _is_within(key, named))


def _kept(config: Config, wanted: Callable[[str], bool]) -> Config:
    """The leaves of a config whose dotted keys are wanted."""
    kept: Config = {}
    for key, value in leaves(config):
        is_usual = (key in USUAL and value == USUAL[key]) or _is_of_other_class(key, config)
        if wanted(key) and not is_usual:
            node = kept
            *parents, last = key.split(".")
            for part in parents:
                node = node.setdefault(part, {})
            node[last] = value
    return kept


def _is_of_other_class(key: str, config: Config) -> bool:
    """Whether a dotted key is a detector's setting of a class that is not among those of the config."""
    if not key.startswith("detector.per_class."):
        return False
    return key.split(".")[2] not in config.get("classes", ["Car"])


def _is_within(key: str, names: Sequence[str]) -> bool:
    """Whether a dotted key is one of some, or of a section that is one of them."""
    return any(key == name or key.startswith(f"{name}.") for name in names)


def of_command_stage(config: Config, whole: Config, has_parent: bool) -> Config:
    """The config of a stage that a command trains: what its own command names, not those of the other stages.

    Args:
        config: the part of the trial's that can change a result, with the stage's changes.
        whole: the trial's, with the stage's changes.
        has_parent: whether the stage goes on from another.
    """
    command = command_of(config["detector"])
    named = [name for name in command.places(has_parent) if not matches(name, BOOKKEEPING)]
    always = ("detector.*", "schedule.stage.epochs", *FRAMES)
    kept = _kept(config, lambda key: matches(key, always) or _is_within(key, named))
    texts = (command.resume, command.results, command.checkpoint or "")
    others = [name for text in texts for name in names_in(text, "detector")]
    others += [
        name
        for name in command.places(has_parent)
        if matches(name, BOOKKEEPING) or name in USUAL  # which the config may not keep
    ]
    places = {name: value_at(whole, name) for name in others if has_key(whole, name)}
    # What is added where there is a parent is nothing to a stage that has none.
    own = {"places": places} if has_parent else {"places": places, "from_parent": []}
    return {**kept, "detector": {**config["detector"], **own}}


def hashed(config: Config) -> Config:
    """What of a stage's config enters its key."""
    if not is_command(config):
        return {str(key): value for key, value in with_stable_names(config).items()}
    others = {key: value for key, value in config.items() if key != "detector"}
    return {**others, "detector": trained_part(config["detector"])}


def reading(config: Config) -> Config:
    """What of a stage's config enters no key, and yet decides which files its checkpoints are read from."""
    return reading_part(config["detector"]) if is_command(config) else {}


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
