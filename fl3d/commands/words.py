"""The words of a sweep: every command takes those that the sweep itself was started with."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from fl3d.config.compose import CONF, Multirun, multirun
from fl3d.config.hydra_app import for_hydra
from fl3d.config.objects import locate
from fl3d.config.overrides import is_interval, values_by_key
from fl3d.config.settings import Settings, read_settings
from fl3d.runs.design import SEED
from fl3d.runs.finished import Asked, FinishedSweep, open_sweep

PUBLISHED = CONF.parent / "results"  # what the project publishes
HELP = "as the sweep was started, such as +sweep=gamma data=kitti seeds=3"


@dataclass(frozen=True)
class Words:
    """What the words of a sweep mean.

    Args:
        multirun: as Hydra reads them.
        settings: of the sweep.
        asked: values by key that were named: of a finished sweep those trials are meant.
    """

    multirun: Multirun
    settings: Settings
    asked: Asked


def read_words(overrides: Sequence[str]) -> Words:
    """Read the words of a sweep, swept values among them.

    Raises:
        ConfigError: a group, option, key or value that does not exist.
    """
    composed = multirun(overrides)
    listed = [
        word for word in for_hydra(overrides) if not is_interval(word)
    ]  # a study's trials are not told by its intervals
    asked = values_by_key(listed)
    door = locate(composed.sweeper["_target_"], "hydra.sweeper._target_")
    if getattr(door, "counts_seeds", False) and len(asked.get(SEED, ())) == 1:
        del asked[SEED]  # says where seeds begin
    return Words(composed, read_settings(composed.base), asked)


def open_words(words: Words) -> FinishedSweep:
    """The finished sweep that words mean.

    Raises:
        StoreError: no trial of it is done here.
    """
    return open_sweep(words.settings, words.asked, PUBLISHED)


def parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """An argument parser of a command."""
    return argparse.ArgumentParser(prog=f"python -m fl3d {name}", description=description)


def names_sweep(overrides: Sequence[str]) -> bool:
    """Whether words name a sweep, by its file or by a name of the user's own."""
    return any(
        word.startswith(("+sweep=", "sweep=", "sweep.name=", "++sweep")) for word in overrides
    )
