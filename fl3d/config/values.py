"""The one place where a config's values are checked, before anything starts: by the ``rules``, and by what is read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from fnmatch import fnmatchcase
from typing import Any

from fl3d.config.rules import (
    BY_CLASS,
    LAUNCHER,
    OPTIMIZER,
    OPTIONAL,
    RULES,
    SECTION,
    SECTIONS,
    Rule,
)
from fl3d.core.errors import ConfigError, options
from fl3d.core.records import Config
from fl3d.evaluation.protocol import Protocol


def check_values(config: Config, raw: Any) -> None:
    """Refuse values that cannot be, keys that nothing reads, and keys that are not there.

    Args:
        config: resolved.
        raw: the same with its interpolations, which read other keys.

    Raises:
        ConfigError: naming the key, and what it may be.
    """
    for name in SECTIONS:
        found = _at(config, name)
        if not isinstance(found, Mapping) and not (name == "data.cloud" and found is ABSENT):
            what = "is not there" if found is ABSENT else f"'{_text(found)}'"
            raise ConfigError(f"{name}: {what}, but it is a section of keys")
    read = set(_names_in(raw))
    for key, value in _leaves(config):
        _check(key, value, read)
    optimizer = config.get("optimizer")
    if isinstance(optimizer, Mapping) and str(optimizer.get("_target_")).startswith("torch."):
        _check_section("optimizer", optimizer, OPTIMIZER)
    for key in RULES:
        is_needed = "*" not in key and not any(fnmatchcase(key, one) for one in OPTIONAL)
        if is_needed and _at(config, key) is ABSENT and not _is_within_null(config, key):
            raise ConfigError(f"{key}: is not there, and fl3d reads it")


def check_launcher(section: Mapping[str, Any]) -> None:
    """Refuse numbers that no launcher takes.

    Raises:
        ConfigError: naming the key, and what it may be.
    """
    _check_section("hydra.launcher", section, LAUNCHER)


def _check_section(name: str, section: Mapping[str, Any], rules: Mapping[str, Rule]) -> None:
    for key, rule in rules.items():
        if key in section and not rule.fits(section[key]):
            raise ConfigError(f"{name}.{key}: {_is_not(section[key], rule)}")


def _check(key: str, value: Any, read: set[str]) -> None:
    own = re.fullmatch(r"schedule\.stages\.[^.]+\.set\.(.+)", key)
    name = own[1] if own else key
    rule = _rule(name)
    if rule is not None:
        if not rule.fits(value):
            raise ConfigError(f"{key}: {_is_not(value, rule)}")
    elif name.partition(".")[0] in BY_CLASS:
        _check_finite(key, value)
        _check_protocol(key, name)
    elif not _is_read(name, read):
        raise ConfigError(f"{key}: no key that anything reads. {_possible(name)}")


def _rule(key: str) -> Rule | None:
    if key in RULES:
        return RULES[key]
    depth = key.count(".")
    patterns = (one for one in RULES if "*" in one and one.count(".") == depth)
    return next((RULES[one] for one in patterns if fnmatchcase(key, one)), None)


def _possible(key: str) -> str:
    """What might stand in place of the first part of a key that is none."""
    parts = key.split(".")
    for depth, part in enumerate(parts):
        beside = _beside(parts[:depth])
        if part not in beside and "*" not in beside:
            return options(part, beside) if beside else f"'{parts[depth - 1]}' holds no keys."
    return options(parts[-1], _beside(parts[:-1]) - {"*"})


def _beside(parents: list[str]) -> set[str]:
    """Names that may stand in a section; ``*``: any."""
    depth = len(parents)
    names = (key.split(".") for key in [*RULES, *BY_CLASS])
    return {
        parts[depth]
        for parts in names
        if len(parts) > depth and all(a in (b, "*") for a, b in zip(parts, parents, strict=False))
    }


def _check_protocol(key: str, name: str) -> None:
    known = [field.name for field in fields(Protocol)]
    parts = name.split(".")
    if parts[0] == "protocol" and len(parts) > 1 and parts[1] not in known:
        raise ConfigError(f"{key}: no key that anything reads. {options(parts[1], known)}")


def _check_finite(key: str, value: Any) -> None:
    """Refuse nan and inf, also in lists: no class can be made of them."""
    items = value if isinstance(value, list) else [value]
    for item in items:
        if isinstance(item, list):
            _check_finite(key, item)
        elif isinstance(item, Mapping):
            for name, inner in _leaves(item):
                _check_finite(f"{key}.{name}", inner)
        elif isinstance(item, float) and not math.isfinite(item):
            raise ConfigError(f"{key}: {item} is not a finite number")


def _is_not(value: Any, rule: Rule) -> str:
    return f"'{_text(value)}' is not {rule.says}"


def _text(value: Any) -> str:
    """A value as YAML writes it, short."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_read(key: str, names: set[str]) -> bool:
    """Whether a text names a key, a section that holds it or a key within it; ``.x`` lies beside the text."""
    for name in names:
        if name.startswith("."):
            if f".{key}".endswith(f".{name.lstrip('.')}"):
                return True
        elif key == name or key.startswith(f"{name}.") or name.startswith(f"{key}."):
            return True
    return False


def _names_in(raw: Any) -> Iterator[str]:
    """Keys that texts name: ``${loss.gamma}`` of OmegaConf's, ``{loss.gamma}`` of a command."""
    if isinstance(raw, Mapping):
        for value in raw.values():
            yield from _names_in(value)
    elif isinstance(raw, list):
        for value in raw:
            yield from _names_in(value)
    elif isinstance(raw, str) and "{" in raw:
        yield from re.findall(r"\{\s*([\w.]+)", raw)
        for inside in re.findall(r"\{[\w.]+:([^}]*)\}", raw):  # arguments of a resolver
            yield from re.findall(r"[\w.]+", inside)


class _Absent:
    """Stands where a key is not there."""


ABSENT = _Absent()


def _at(config: Mapping[str, Any], key: str) -> Any:
    node: Any = config
    for part in key.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return ABSENT
        node = node[part]
    return node


def _is_within_null(config: Mapping[str, Any], key: str) -> bool:
    """Whether a section above the key is null, and may be."""
    return _rule(key.rpartition(".")[0]) is SECTION and _at(config, key.rpartition(".")[0]) is None


def _leaves(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in config.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{name}.")
        else:
            yield name, value
