"""Build the objects that a config's sections name by ``_target_``."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable
from typing import Any

from hydra.errors import HydraException
from hydra.utils import get_class, instantiate

from fl3d.core.errors import ConfigError
from fl3d.core.records import Config

_NAMED: list[str] = []  # folders of the user's own, see ``make_importable``


def build(section: Config, name: str, **arguments: Any) -> Any:
    """Make the object that a config section's ``_target_`` names.

    Args:
        section: ``_target_`` and its arguments.
        name: of the section, for errors.
        arguments: further ones, already objects.

    Raises:
        ConfigError: the target does not exist or does not take these arguments.
    """
    target = section["_target_"]
    own = {key: value for key, value in section.items() if not key.startswith("_")}
    try:
        inspect.signature(locate(target, name)).bind(**own, **arguments)
    except TypeError as error:
        raise ConfigError(f"{name}: {target}: {error}") from None
    try:
        # Partial, for Hydra would turn arguments that are dataclasses into configs.
        return instantiate({**section, "_partial_": True}, _convert_="all")(**arguments)
    except HydraException as error:
        cause = error.__cause__
        raise (
            cause if isinstance(cause, ConfigError) else ConfigError(f"{name}: {error}")
        ) from None


def locate(target: str, name: str) -> Any:
    """The class that a ``_target_`` names.

    Raises:
        ConfigError: there is none.
    """
    try:
        return get_class(target)
    except Exception as error:
        raise ConfigError(f"{name}: {error}") from None


def make_importable(folders: Iterable[str]) -> None:
    """Let ``_target_`` name modules in folders of the user's own; those that were named first are asked first.

    What the command line names comes before what a stage was trained with: that may have been moved, and another's lie
    there now.
    """
    for folder in folders:
        if folder not in sys.path:
            sys.path.insert(sum(path in _NAMED for path in sys.path), folder)
            _NAMED.append(folder)
