"""Build the objects that a config's sections name by ``_target_``."""

from __future__ import annotations

import inspect
import logging
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from hydra.utils import get_class, instantiate

from fl3d.core.errors import ConfigError, options
from fl3d.core.extras import lacking
from fl3d.core.records import Config
from fl3d.core.typed import check_types

logging.getLogger("hydra.utils").setLevel(logging.CRITICAL)  # it prints what it raises
# What a class raises for values that it cannot be made of.
SLIPS = (
    *(TypeError, ValueError, ArithmeticError, LookupError, RuntimeError),
    *(AttributeError, AssertionError),
)


def build(section: Config, name: str, **arguments: Any) -> Any:
    """Make the object that a config section's ``_target_`` names.

    Args:
        section: ``_target_`` and its arguments.
        name: of the section, for errors.
        arguments: further ones, already objects.

    Raises:
        ConfigError: the target does not exist or does not take these arguments.
    """
    if not isinstance(section, Mapping) or "_target_" not in section:
        raise ConfigError(f"{name}: {section}, but it is a section with a _target_")
    target = section["_target_"]
    own = {key: value for key, value in section.items() if not key.startswith("_")}
    kind = locate(target, name)
    _check_names(kind, own, arguments, f"{name}: {target}")
    _check(kind, own, name)
    try:
        # Partial, for Hydra would turn arguments that are dataclasses into configs.
        return instantiate({**section, "_partial_": True}, _convert_="all")(**arguments)
    except HydraException as error:
        cause = error.__cause__
        if isinstance(cause, ConfigError):
            raise cause from None
        why = _told(cause) if isinstance(cause, Exception) else error
        raise ConfigError(f"{name}: {why}") from None
    except SLIPS as error:
        raise ConfigError(f"{name}: {target}: {_told(error)}") from None


def _check_names(kind: Any, own: Config, arguments: Config, where: str) -> None:
    """Refuse arguments that a class does not take, or that it lacks."""
    signature = inspect.signature(kind)
    try:
        signature.bind(**own, **arguments)
    except TypeError as error:
        possible = [key for key in signature.parameters if key not in arguments]
        unknown = [key for key in own if key not in possible]
        hint = f". {options(unknown[0], possible)}" if unknown else ""
        raise ConfigError(f"{where}: {error}{hint}") from None


def _check(kind: Any, own: Config, name: str) -> None:
    """Refuse arguments that are not of their types, also of the objects among them."""
    plain = {key: value for key, value in own.items() if not _is_object(value)}
    check_types(kind, plain, name)
    for key, value in own.items():
        if _is_object(value):
            inner = {field: one for field, one in value.items() if not field.startswith("_")}
            _check(locate(value["_target_"], f"{name}.{key}"), inner, f"{name}.{key}")


def _is_object(value: Any) -> bool:
    return isinstance(value, Mapping) and "_target_" in value


def _told(error: Exception) -> str:
    """An error of a class that could not be made, with the place where it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = str(error).strip().partition("\n")[0] or "no reason given"
    return f"{type(error).__name__}: {text} ({Path(last.filename).name}:{last.lineno})"


def locate(target: str, name: str) -> Any:
    """The class that a ``_target_`` names.

    Raises:
        ConfigError: there is none.
    """
    if not isinstance(target, str):
        raise ConfigError(f"{name}: '{target}', but a _target_ is the import path of a class")
    try:
        return get_class(target)
    except Exception as error:
        why = lacking(error)
        said = f"{target} {why}" if why else " ".join(str(error).split())
        raise ConfigError(f"{name}: {said}") from None
