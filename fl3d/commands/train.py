"""``python -m fl3d KEY=VALUE ...``: train one trial; with -m a sweep. Hydra reads the command line."""

from __future__ import annotations

import os
import shlex
import sys
import warnings

from fl3d.api.training import train
from fl3d.config.checks import check_overrides
from fl3d.config.command_line import Line, read_line
from fl3d.config.compose import resolve, section, task_words
from fl3d.config.hydra_app import HYDRAS, for_hydra, hydra_says
from fl3d.config.overrides import parse
from fl3d.config.places import CONF, MAIN, own_folders
from fl3d.core.errors import (
    ConfigError,
    Fl3dError,
)
from fl3d.sweep.by_hand import name_trial
from fl3d.sweep.sweepers.grid import Listed, point_of

SLIP = 2  # exit code of a mistake, see ``cli``
SCRIPT = "fl3d"  # what pip installs; a shell completes its words, for it completes by a command's first word


def run(arguments: list[str]) -> None:
    """Hand a command line to Hydra, which calls back with a trial, or, under -m, through its sweeper plugins.

    Raises:
        ConfigError: an option or an override that does not fit.
        StageFailed: a stage failed; all others are trained and scored.
    """
    import hydra
    from omegaconf import DictConfig

    line = read_line(arguments)
    words = list(line.overrides)
    if not line.is_completion:
        check_overrides(words)
        _refuse_sweep_of_one(line)
        words = for_hydra(words)
    warnings.filterwarnings("ignore", message=".*hydra.*", category=DeprecationWarning)
    ended: list[BaseException] = []

    @hydra.main(config_path=str(CONF), config_name=MAIN, version_base="1.3")
    def task(config: DictConfig) -> None:
        try:
            _one_trial(config)
        except (Fl3dError, KeyboardInterrupt) as error:
            ended.append(error)  # past Hydra, which would print a message of its own

    # Hydra would print an error and a hint of its own; with the full error on, ours comes through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    own = [word for folder in own_folders() for word in ("--config-dir", str(folder))]
    sys.argv = [SCRIPT if line.is_completion else "python -m fl3d", *line.options, *words, *own]
    try:
        task()
    except HYDRAS as error:
        raise ConfigError(hydra_says(error)) from None
    except RuntimeError as error:
        if not str(error).startswith("Invalid plugin"):
            raise
        raise ConfigError(
            f"hydra.sweeper._target_, hydra.launcher._target_: {error}; choose them by hydra/sweeper=NAME and "
            "hydra/launcher=NAME"
        ) from None
    except SystemExit as error:
        # Hydra says that there is no such package, and ends as if a job had failed.
        error.code = SLIP if line.is_look and error.code == 1 else error.code
        raise
    if ended:
        raise ended[0]


def _refuse_sweep_of_one(line: Line) -> None:
    """Refuse several values where one trial is meant.

    Raises:
        ConfigError: saying how a sweep, a list and a text are typed.
    """
    is_sweep = line.is_multirun or any(word.startswith("hydra.mode=") for word in line.overrides)
    for word in line.overrides:
        if not is_sweep and parse(word).is_sweep_override():
            key, _, value = word.partition("=")
            as_text = shlex.quote(f'{key}="{value}"')
            raise ConfigError(
                f"{word}: several values are a sweep: python -m fl3d -m ...; a list is typed {key}=[...], and a text "
                f"that looks so {as_text}"
            )


def _one_trial(config: object) -> None:
    from hydra.core.hydra_config import HydraConfig

    hydra = HydraConfig.get()
    resolved = resolve(config)  # type: ignore[arg-type]
    words = task_words(hydra)
    files = [word for word in words if word.lstrip("+").startswith("sweep=")]
    if files:
        raise ConfigError(f"a sweep file is run with -m: python -m fl3d -m {files[0]}")
    name_trial(resolved)
    launcher = section(hydra, "launcher")
    train(Listed([point_of(words, resolved)]), launcher, words)
