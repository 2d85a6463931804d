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
from fl3d.core.nested import has_key, leaves, value_at
from fl3d.core.records import Config
from fl3d.evaluation.protocol import Protocol

NESTED = "${${"  # stands for a name that is itself a value: it may be any


def check_values(config: Config, raw: Any) -> None:
    """Refuse values that cannot be, keys that nothing reads, and keys that are not there.

    Args:
        config: resolved.
        raw: the same with its interpolations, which read other keys.

    Raises:
        ConfigError: naming the key, and what it may be.
    """
    for name in SECTIONS:
        is_there = has_key(config, name)
        found = value_at(config, name) if is_there else None
        if not isinstance(found, Mapping) and (is_there or name != "data.cloud"):
            what = f"'{_text(found)}'" if is_there else "is not there"
            raise ConfigError(f"{name}: {what}, but it is a section of keys")
    names = names_in(raw)
    for key, value in leaves(config):
        _check(key, value, names)
    _check_optimizer(config)
    for key in RULES:
        is_needed = "*" not in key and not any(fnmatchcase(key, one) for one in OPTIONAL)
        if is_needed and not has_key(config, key) and not _is_within_null(config, key):
            raise ConfigError(f"{key}: is not there, and fl3d reads it")


def check_value(key: str, config: Config, names: set[str]) -> None:
    """Refuse a plain value that cannot be, of a config whose other values were checked.

    Args:
        key: in dots.
        config: resolved.
        names: see ``names_in``.

    Raises:
        ConfigError: naming the key, and what it may be.
    """
    _check(key, value_at(config, key), names)
    _check_optimizer(config)


def _check_optimizer(config: Config) -> None:
    optimizer = config.get("optimizer")
    if isinstance(optimizer, Mapping) and str(optimizer.get("_target_")).startswith("torch."):
        _check_section("optimizer", optimizer, OPTIMIZER)


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


def _check(key: str, value: Any, names: set[str]) -> None:
    own = re.fullmatch(r"schedule\.stages\.[^.]+\.set\.(.+)", key)
    name = own[1] if own else key
    rule = _rule(name)
    if rule is not None:
        if not rule.fits(value):
            raise ConfigError(f"{key}: {_is_not(value, rule)}")
    elif name.partition(".")[0] in BY_CLASS:
        _check_finite(key, value)
        _check_protocol(key, name)
    elif not is_named(name, names):
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
    known = [field.name for field in fields(Protocol) if field.name != "classes"]  # a key above
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
            for name, inner in leaves(item):
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


def is_named(key: str, names: set[str]) -> bool:
    """Whether a text names a key, a section that holds it or a key within it; ``.x`` lies beside the text.

    Args:
        key: in dots.
        names: see ``names_in``.
    """
    if NESTED in names:
        return True
    for name in names:
        if name.startswith("."):
            if f".{key}".endswith(f".{name.lstrip('.')}"):
                return True
        elif key == name or key.startswith(f"{name}.") or name.startswith(f"{key}."):
            return True
    return False


def names_in(raw: Any) -> set[str]:
    """Keys that the texts of a config name: ``${loss.gamma}`` of OmegaConf's, ``{loss.gamma}`` of a command.

    Args:
        raw: the config with its interpolations.
    """
    return set(_names_in(raw))


def _names_in(raw: Any) -> Iterator[str]:
    if isinstance(raw, Mapping):
        for value in raw.values():
            yield from _names_in(value)
    elif isinstance(raw, list):
        for value in raw:
            yield from _names_in(value)
    elif isinstance(raw, str) and "{" in raw:
        yield from re.findall(r"\{\s*([\w.]+)", raw)
        if re.search(r"\$\{[^{}]*\$\{", raw):
            yield NESTED
        for inside in re.findall(r"\{[\w.]+:([^}]*)\}", raw):  # arguments of a resolver
            yield from re.findall(r"[\w.]+", inside)


def _is_within_null(config: Mapping[str, Any], key: str) -> bool:
    """Whether a section above the key is null, and may be."""
    section = key.rpartition(".")[0]
    is_null = has_key(config, section) and value_at(config, section) is None
    return is_null and _rule(section) is SECTION
