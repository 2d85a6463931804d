"""What was typed for Hydra: its options, checked, and the overrides, wherever they stand among them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

from hydra._internal.utils import get_args_parser

from fl3d.config.places import MAIN
from fl3d.core.errors import ConfigError, options

SHELLS = ("bash", "fish", "zsh")
COMPLETION = ("install", "uninstall", "query")
# Options of Hydra's that stand without a value, and with one.
FLAGS = ("help", "hydra_help", "resolve", "run", "multirun", "shell_completion")
VALUES = ("cfg", "package", "info")
ONE_OF = ("run", "multirun", "cfg", "info", "shell_completion")


@dataclass(frozen=True)
class Line:
    """A command line of Hydra's.

    Args:
        options: Hydra's, as Hydra takes them.
        overrides: KEY=VALUE and the like.
        is_multirun: whether a sweep is asked for.
        is_look: whether something is shown, and nothing trained.
        is_completion: whether a shell asks how to complete words; then the overrides are none.
    """

    options: tuple[str, ...]
    overrides: tuple[str, ...]
    is_multirun: bool
    is_look: bool
    is_completion: bool


def read_line(arguments: Sequence[str]) -> Line:
    """Read a command line.

    Raises:
        ConfigError: options that do not exist or do not go together, or a word that is no override.
    """
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]
    given = parser.parse_intermixed_args(list(arguments))
    _check_options(given)
    if given.shell_completion:
        _check_completion(given.overrides)
    else:
        for word in given.overrides:
            if "=" not in word and not word.startswith("~"):
                raise ConfigError(
                    f"'{word}' is neither KEY=VALUE nor a command; python -m fl3d --help lists both"
                )
    flags = [f"--{name.replace('_', '-')}" for name in FLAGS if getattr(given, name)]
    pairs = [(f"--{name}", getattr(given, name)) for name in VALUES]
    valued = [word for name, value in pairs if value is not None for word in (name, value)]
    return Line(
        options=(*flags, *valued),
        overrides=tuple(given.overrides),
        is_multirun=given.multirun,
        is_look=bool(given.help or given.hydra_help or given.cfg or given.info),
        is_completion=given.shell_completion,
    )


def _refuse(message: str) -> NoReturn:
    raise ConfigError(f"{message}; python -m fl3d --hydra-help lists Hydra's options")


def _check_options(given: argparse.Namespace) -> None:
    if given.multirun and given.cfg:
        raise ConfigError("--cfg shows the config of one trial: leave -m and swept values out")
    several = [f"--{name.replace('_', '-')}" for name in ONE_OF if getattr(given, name)]
    if len(several) > 1:
        raise ConfigError(f"{' and '.join(several)}: one of them alone can be given")
    if given.package is not None and not given.cfg:
        raise ConfigError(f"--package {given.package}: which part --cfg job shows; give both")
    if given.resolve and not (given.cfg or given.help):
        raise ConfigError("--resolve: how --cfg job shows a config; give both")
    if given.experimental_rerun is not None:
        raise ConfigError(
            "--experimental-rerun: fl3d keeps no such file; the same words again resume what was interrupted, and "
            "train nothing that is done"
        )
    if given.config_path is not None or given.config_name not in (None, MAIN):
        raise ConfigError(
            "--config-path, --config-name: fl3d's own config is the one that it trains by; YAMLs of your own are "
            "found in a folder given by --config-dir FOLDER"
        )


def _check_completion(words: Sequence[str]) -> None:
    pairs = [word.partition("=") for word in words]
    if len(pairs) != 1 or pairs[0][0] not in COMPLETION or pairs[0][2] not in SHELLS:
        typed = " ".join(words) or "nothing"
        possible = [f"{what}={shell}" for what in COMPLETION[:2] for shell in SHELLS]
        raise ConfigError(f"--shell-completion {typed}: {options(typed, possible)}")
    if pairs[0][0] == "query" and "COMP_LINE" not in os.environ:
        raise ConfigError(
            f"--shell-completion {words[0]}: is asked by a shell that completes a word (COMP_LINE is not set)"
        )
