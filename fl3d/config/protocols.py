"""Protocols by name, for what evaluates results and composes no whole trial."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from fl3d.config.places import CONF, options_of
from fl3d.core.errors import ConfigError, options
from fl3d.evaluation.protocol import Protocol


def read_protocol(name: str, changes: Sequence[str] = ()) -> Protocol:
    """A protocol by its name.

    Args:
        name: such as ``kitti``.
        changes: words such as ``overlaps.Car=[0.7,0.5,0.5]``; ``+overlaps.Cone=[0.5,0.25,0.25]`` adds a class.

    Raises:
        ConfigError: there is no such protocol, or a change does not fit it.
    """
    possible = options_of("protocol")
    if name not in possible:
        raise ConfigError(f"protocol: no option '{name}'. {options(name, possible)}")
    file = CONF / "protocol" / f"{name}.yaml"
    if not changes and file.is_file():
        return Protocol(**_plain(file))
    return _composed(name, changes)


def _plain(file: Path) -> dict[str, Any]:
    """The values of one of fl3d's own files and of those that it builds on, as Hydra merges them, without Hydra.

    Hydra takes as long as all else that an evaluation loads.
    """
    own = yaml.safe_load(file.read_text(encoding="utf-8"))
    merged: dict[str, Any] = {}
    for below in own.pop("defaults", []):
        _merge(merged, _plain(file.with_name(f"{below}.yaml")))
    _merge(merged, own)
    return merged


def _merge(into: dict[str, Any], values: dict[str, Any]) -> None:
    for key, value in values.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value


def _composed(name: str, changes: Sequence[str]) -> Protocol:
    from fl3d.config.compose import compose_config
    from fl3d.config.settings import read_settings

    for word in changes:
        if "=" not in word:
            raise ConfigError(f"'{word}' is neither --option nor KEY=VALUE of the protocol")
    words = [_of_protocol(word) for word in changes]
    return read_settings(compose_config([f"protocol={name}", "profile=paper", *words])).protocol


def _of_protocol(word: str) -> str:
    """A change as a word of the config."""
    plus = "+" if word.startswith("+") else ""
    return f"{plus}protocol.{word.removeprefix('+').removeprefix('protocol.')}"
