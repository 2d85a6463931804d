"""Texts with places for values, ``--gamma={loss.gamma}``: which places they name, and how they are filled. Pure."""

from __future__ import annotations

import difflib
import json
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from fl3d.core.errors import ConfigError

Line = str | Sequence[str]  # a line of bash, or a list of arguments
# Sections of the config that few commands name; errors do not list their keys.
FL3D_SECTIONS = (
    *("augment", "compile", "data", "detections", "detector", "device", "precision", "profile"),
    *("protocol", "results", "schedule", "selection", "store", "sweep", "workers"),
)


class Bash(str):
    """A text that is bash already, and comes into another unquoted."""


_PART = re.compile(r"\{\{|\}\}|\{([^{}]*)\}|[{}]")


def names_in(line: Line, where: str) -> list[str]:
    """Names of the places in a text or in each of several, in order, each once.

    Args:
        line: a text, or several.
        where: key of the config, for errors.

    Raises:
        ConfigError: a brace that begins or ends no place.
    """
    texts = [line] if isinstance(line, str) else line
    found: dict[str, None] = {}
    for text in texts:
        for match in _PART.finditer(text):
            if match[0] in ("{", "}"):
                raise ConfigError(
                    f"{where}: '{text}': a single {match[0]} is no placeholder; "
                    f"write {match[0] * 2} where the character itself is meant"
                )
            if match[1] is not None:
                found[match[1]] = None
    return list(found)


def check_names(line: Line, where: str, own: Sequence[str], keys: Sequence[str] = ()) -> None:
    """Refuse places that have no value.

    Args:
        line: a text, or several.
        where: key of the config, for errors.
        own: names that have a value.
        keys: of the config, which have one too; there are many.

    Raises:
        ConfigError: naming the place, and those that have one.
    """
    for name in names_in(line, where):
        if name in own or name in keys:
            continue
        near = difflib.get_close_matches(name, [*own, *keys], n=1)
        hint = f"Did you mean '{near[0]}'? " if near else ""
        theirs = [key for key in keys if key.partition(".")[0] not in FL3D_SECTIONS]
        more = "; or any other key of the config (--cfg job shows them)" if keys else ""
        raise ConfigError(
            f"{where}: no placeholder {{{name}}}. {hint}Possible: {', '.join([*own, *theirs])}{more}."
        )


def fill(line: Line, values: Mapping[str, Any]) -> str | list[str]:
    """A command line with its values, ready to be started.

    Of a list each item is one argument, whatever its values hold: no shell reads it. An item that is nothing but the
    place of a list becomes an argument for each of the list's items. Of a text, which bash reads, each value is quoted.

    Args:
        line: whose places all have values.
        values: by name.
    """
    if isinstance(line, str):
        return fill_text(line, values, shell_text)
    return list(_arguments(line, values))


def _arguments(line: Sequence[str], values: Mapping[str, Any]) -> Iterator[str]:
    for item in line:
        whole = _PART.fullmatch(item)
        value = values[whole[1]] if whole is not None and whole[1] is not None else None
        if isinstance(value, Sequence) and not isinstance(value, str):
            yield from (value_text(one) for one in value)
        else:
            yield fill_text(item, values)


def fill_text(
    text: str, values: Mapping[str, Any], write: Callable[[Any], str] | None = None
) -> str:
    """A text with its values.

    Args:
        text: whose places all have values.
        values: by name.
        write: how a value is written; None: as ``value_text`` does.
    """
    as_text = write or value_text

    def part(match: re.Match[str]) -> str:
        return match[0][0] if match[1] is None else as_text(values[match[1]])

    return _PART.sub(part, text)


def value_text(value: Any) -> str:
    """A value as an argument: text as it is, 0.5, 2, true, null; lists and mappings as JSON."""
    if isinstance(value, str):
        return value
    if isinstance(value, float) and not isinstance(value, bool):
        return repr(value)
    return json.dumps(value, separators=(",", ":"))


def shell_text(value: Any) -> str:
    """A value as one word of bash, or of a list a word for each item."""
    if isinstance(value, Bash):
        return value
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " ".join(shlex.quote(value_text(one)) for one in value)
    return shlex.quote(value_text(value))
