"""Words of a command line in Hydra's grammar: what each sets, and to which values."""

from __future__ import annotations

import copy
import decimal
import itertools
import re
import shlex
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import (
    ChoiceSweep,
    Glob,
    Override,
    QuotedString,
    Transformer,
    ValueType,
)
from hydra.errors import HydraException

from fl3d.config.places import groups, is_group, options_of
from fl3d.core.errors import ConfigError, options

_LIST = re.compile(r"^(?:choice|sort|shuffle)\((.*)\)$", re.S)  # around values
MOST_VALUES = 10_000  # of one key: a larger sweep is a slip, such as range(0,1000000)


def parse(line: str) -> Override:
    """Read one override; ``glob(...)`` is a choice among a group's files.

    Raises:
        ConfigError: it is not in Hydra's grammar, or a glob that matches nothing or stands among other values.
    """
    try:
        override = _parsed(line)
    except HydraException as error:
        raise ConfigError(
            f"'{line}' is not KEY=VALUE in Hydra's grammar: {str(error).splitlines()[0]}{_quoted(line)}"
        ) from None
    pattern: Any = override.value()
    if isinstance(pattern, Glob):
        chosen: list[Any] = list(_matching(override.key_or_group, pattern, line))
        override = copy.copy(override)
        override._value = ChoiceSweep(list=chosen)
        override.value_type = ValueType.CHOICE_SWEEP
    elif isinstance(pattern, ChoiceSweep) and any(isinstance(one, Glob) for one in pattern.list):
        raise ConfigError(f"'{line}': glob(...) stands alone; beside other values name the files")
    return override


@lru_cache(maxsize=10_000)  # a large sweep has few words, each in many trials
def _parsed(line: str) -> Override:
    return OverridesParser.create().parse_override(line)


def same_key(override: Override) -> str:
    """What an override sets, whether it adds or changes: ``++loss.gamma`` and ``loss.gamma`` are one key."""
    package = f"@{override.package}" if override.package is not None else ""
    return f"{override.key_or_group}{package}"


def chooses_group(override: Override) -> bool:
    """Whether it chooses options of a config group, or none of them; ``loss={gamma:2}`` sets keys instead."""
    if not is_group(override.key_or_group):
        return False
    value: Any = override.value()
    listed = value.list if isinstance(value, ChoiceSweep) else [value]
    return not any(isinstance(one, Mapping) for one in listed)


def _matching(group: str, pattern: Glob, line: str) -> list[str]:
    """Files of a group that a glob names."""
    if not is_group(group):
        raise ConfigError(
            f"{line}: glob(...) names files of a group, and {group} is none. {options(group, groups())}"
        )
    found = pattern.filter(options_of(group))
    if not found:
        raise ConfigError(f"{line}: matches no file of the group. {options('', options_of(group))}")
    return found


def _quoted(line: str) -> str:
    """How to type a value that holds what Hydra's grammar does not, such as blanks, brackets, ``=`` or ``é``."""
    key, is_assigned, value = line.partition("=")
    if not is_assigned or not value or value[0] in "[{\"'":  # a list, a dict or quoted already
        return ""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    typed = shlex.quote(f'{key}="{escaped}"')
    return f". To give it as text, quote it twice: {typed}"


def is_interval(line: str) -> bool:
    """Whether an override sweeps an interval, as a study does."""
    override = parse(line)
    return override.is_sweep_override() and not override.is_discrete_sweep()


def is_range(line: str) -> bool:
    """Whether an override sweeps a range: a grid takes its values for a choice, and a study for numbers."""
    return parse(line).is_range_sweep()


def values_by_key(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """What overrides say, swept or not, as plain values: ``seed=0,1`` -> ``{"seed": [0, 1]}``.

    Raises:
        ConfigError: an interval, whose values cannot be listed.
    """
    found: dict[str, list[Any]] = {}
    for override in (parse(line) for line in arguments):
        key = override.key_or_group
        if override.is_delete():
            found.pop(key, None)
        else:
            found[key] = plain_values(override)
    return found


def plain_values(override: Override) -> list[Any]:
    """The values that an override sets, one or several.

    Raises:
        ConfigError: an interval, whose values cannot be listed, or no value at all.
    """
    if not override.is_sweep_override():
        return [_plain(override.value())]
    return [_plain(value) for value in _listed(override, Transformer.identity)]


def typed_words(override: Override) -> tuple[str, ...]:
    """The words of an override, one for each of its values.

    Raises:
        ConfigError: see ``plain_values``; or two numbers that are equal and typed differently.
    """
    if not override.is_sweep_override():
        return (str(override.input_line),)
    _refuse_equal(override)
    key = override.get_key_element()
    return tuple(f"{key}={value}" for value in _listed(override, Transformer.str))


def _refuse_equal(override: Override) -> None:
    """Refuse 2 and 2.0, or 1e-3 and 0.001: they are one training, where the user means two.

    What is typed twice alike, such as ``seed=0,0``, is one trial and no slip.
    """
    value: Any = override.value()
    if not isinstance(value, ChoiceSweep) or not override.input_line:
        return
    text = override.input_line.partition("=")[2]
    typed = [part.strip() for part in _LIST.sub(r"\1", text.strip()).split(",")]
    if len(typed) != len(value.list):
        return  # lists, or texts with commas
    first: dict[float, str] = {}
    for own, number in zip(typed, value.list, strict=True):
        if isinstance(number, int | float) and not isinstance(number, bool):
            known = first.setdefault(number, own)
            if known != own:
                raise ConfigError(
                    f"{override.input_line}: {own} is the same value as {known}, and so the same training; keep one"
                )


def _listed(override: Override, transformer: Any) -> list[Any]:
    line = override.input_line
    try:
        values = list(itertools.islice(override.sweep_iterator(transformer), MOST_VALUES + 1))
    except HydraException:
        if override.is_range_sweep():
            raise ConfigError(f"'{line}': a range of step 0 has no end") from None
        raise ConfigError(
            f"'{line}': a grid needs values that can be listed, such as 0,1,2 or range(0,3); "
            "to search an interval add hydra/sweeper=optuna"
        ) from None
    except (ValueError, OverflowError, decimal.DecimalException) as error:
        raise ConfigError(
            f"'{line}': no range of numbers ({type(error).__name__}); such as range(0,3) or range(0,1,0.25)"
        ) from None
    if not values:
        raise ConfigError(f"'{line}': holds no value; range(0,3) is 0,1,2, and its end is left out")
    if len(values) > MOST_VALUES:
        raise ConfigError(f"'{line}': more than {MOST_VALUES} values; is it meant?")
    return values


def _plain(value: Any) -> Any:
    """A parsed value without Hydra's own classes."""
    if isinstance(value, QuotedString):
        return value.text
    if isinstance(value, Mapping):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value
