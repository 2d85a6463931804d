"""Nested configs by dotted keys, such as ``loss.gamma``. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def leaves(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a nested config; an empty mapping is a leaf."""
    for key, value in config.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{name}.")
        else:
            yield name, value


def has_key(config: Mapping[str, Any], name: str) -> bool:
    """Whether a nested config has a dotted key."""
    node: Any = config
    for part in name.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return False
        node = node[part]
    return True


def value_at(config: Mapping[str, Any], name: str) -> Any:
    """The value, or the section, at a dotted key that is there."""
    node: Any = config
    for part in name.split("."):
        node = node[part]
    return node
