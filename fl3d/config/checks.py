"""Words of a command line, before anything is composed of them: misspelt groups, options and keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydra.core.override_parser.types import ChoiceSweep, Override
from omegaconf import DictConfig, OmegaConf

from fl3d.config.hydra_app import composed, hydra_session
from fl3d.config.overrides import chooses_group, parse, same_key
from fl3d.config.places import config_folders, groups, options_of
from fl3d.core.errors import ConfigError, options

# Groups that every trial needs an option of; of the others null is an option.
NEEDED = ("data", "detector", "profile", "protocol", "schedule")
OWN_HYDRA = ("hydra/launcher", "hydra/sweeper")  # groups of Hydra's whose options are fl3d's
CHECKED_HYDRA = ("hydra.launcher", "hydra.sweeper")  # sections of Hydra's that are fl3d's


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse misspelt groups, options and keys, saying which there are.

    Raises:
        ConfigError: the first override that does not fit.
    """
    parsed = [parse(line) for line in overrides]
    known = groups()
    chosen: dict[str, str] = {}
    keys: list[Override] = []
    for override in parsed:
        key = override.key_or_group
        if chooses_group(override) and (not key.startswith("hydra") or key in OWN_HYDRA):
            _check_group(override)
            if not override.is_delete():
                plus = "+" if override.is_add() else ""
                chosen[same_key(override)] = f"{plus}{same_key(override)}={_choices(override)[0]}"
        elif key in NEEDED:
            raise ConfigError(f"{override.input_line}: {_needed(key)}")
        elif not key.startswith("hydra") or key.startswith(CHECKED_HYDRA) or _adds(override):
            keys.append(override)
    _check_keys(keys, list(chosen.values()), known)


def _check_group(override: Override) -> None:
    group = override.key_or_group
    if override.is_delete() and group in (*NEEDED, *OWN_HYDRA):
        raise ConfigError(f"{override.input_line}: {_needed(group)}")
    if override.is_delete():
        return
    for option in _choices(override):
        _check_option(group, option)


def _needed(group: str) -> str:
    return f"a trial needs one. {options('', options_of(group))}"


def _choices(override: Override) -> list[str]:
    """The options that it names."""
    value: Any = override.value()
    listed = value.list if isinstance(value, ChoiceSweep) else [value]
    return ["null" if one is None else str(getattr(one, "text", one)) for one in listed]


def _check_option(group: str, option: str) -> None:
    if option == "null" and group not in (*NEEDED, *OWN_HYDRA):
        return
    present = options_of(group)
    if option not in present:
        own = "".join(f" or {place / group}" for place in config_folders()[1:])
        raise ConfigError(
            f"{group}={option}: no such file in conf/{group}{own}. {options(option, present)}"
        )


def _check_keys(overrides: Sequence[Override], chosen: Sequence[str], known: set[str]) -> None:
    """Refuse keys that are neither there nor added by a word before."""
    if all(_adds(override) and not override.is_hydra_override() for override in overrides):
        return
    with hydra_session():
        base = composed(chosen, with_hydra=True)
    added: list[str] = []
    for override in overrides:
        key = override.key_or_group
        if _adds(override):
            added.append(key)
            if override.is_hydra_override():
                _check_key(base, ".".join(key.split(".")[:2]), override.input_line or key, known)
        elif not any(key == one or key.startswith(f"{one}.") for one in added):
            _check_key(base, key, override.input_line or key, known)


def _adds(override: Override) -> bool:
    return override.is_add() or override.is_force_add()


def _check_key(base: DictConfig, key: str, line: str, known: set[str]) -> None:
    node: Any = base
    parts = key.split(".")
    for depth, part in enumerate(parts):
        if not OmegaConf.is_dict(node) or part not in node:
            where = ".".join(parts[:depth])
            present = [str(k) for k in node] if OmegaConf.is_dict(node) else []
            if depth == 0:
                possible = {name for name in {*present, *known} if not name.startswith("hydra")}
                raise ConfigError(
                    f"{line}: no key or group '{part}'. {options(part, possible | set(OWN_HYDRA))}"
                )
            raise ConfigError(f"{line}: no key '{part}' in '{where}'. {options(part, present)}")
        node = OmegaConf.select(
            base, ".".join(parts[: depth + 1]), throw_on_resolution_failure=False
        )
