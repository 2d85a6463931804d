"""Gives what was typed by hand, without a name, one of its own: two at once do not meet. See ``runs.by_hand_names``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fl3d.config.compose import Multirun
from fl3d.config.objects import locate
from fl3d.config.settings import BY_HAND
from fl3d.core.nested import leaves
from fl3d.core.records import Config
from fl3d.runs.by_hand_names import sweep_name, trial_name
from fl3d.sweep.identity import result_config

DATA = ("name", "seed", "train_split", "val_split", "train_frames", "val_frames")

# Of a search: where it is kept and how long it goes on. All else in its section tells one study from another.
GOES_ON = ("n_trials", "storage", "params", "_recursive_")


def named(multirun: Multirun) -> Multirun:
    """A sweep with a name made of its words, unless it has one."""
    if multirun.base["sweep"]["name"] != BY_HAND:
        return multirun
    sweeper = multirun.sweeper
    door = locate(sweeper["_target_"], "hydra.sweeper._target_")
    settings = {key: value for key, value in sweeper.items() if key not in GOES_ON}
    search = settings if getattr(door, "searches", False) else None
    name = sweep_name(multirun.arguments, sweeper["params"], search)

    def compose(overrides: Sequence[str]) -> Config:
        return _with_name(multirun.compose(overrides), name)

    return replace(multirun, base=_with_name(multirun.base, name), compose=compose)


def name_trial(config: Config) -> None:
    """Give a single trial a name made of its values, unless it has one."""
    if config["sweep"]["name"] == BY_HAND:
        frames = {key: config["data"][key] for key in DATA}
        config["sweep"]["name"] = trial_name([frames, *leaves(result_config(config))])


def _with_name(config: Config, name: str) -> Config:
    """A config that has no name gets one; names that the words sweep stay, and are refused by the planner."""
    if config["sweep"]["name"] != BY_HAND:
        return config
    return {**config, "sweep": {**config["sweep"], "name": name}}
