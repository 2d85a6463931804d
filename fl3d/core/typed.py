"""Values of a config beside the types that a class asks for: text is no number, null nothing that is needed. Pure.

A class says ``points: Count`` or ``overlap: Share``; to a type checker these are int and float.
"""

from __future__ import annotations

import inspect
import math
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fl3d.core.errors import ConfigError, options

Made = TypeVar("Made")
SAYS = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a text"}


@dataclass(frozen=True)
class Within:
    """A range of numbers.

    Args:
        says: the same for people.
        holds: whether a number lies in it.
    """

    says: str
    holds: Callable[[float], bool]


Count = Annotated[int, Within("of at least 1", lambda number: number >= 1)]
Whole = Annotated[int, Within("of at least 0", lambda number: number >= 0)]
Positive = Annotated[float, Within("above 0", lambda number: number > 0)]
NotNegative = Annotated[float, Within("of at least 0", lambda number: number >= 0)]
Share = Annotated[float, Within("from 0 to 1", lambda number: 0 <= number <= 1)]


def make(kind: Callable[..., Made], section: Any, name: str, **more: Any) -> Made:
    """Make a record of a section of a config.

    Args:
        kind: its class.
        section: arguments, by name.
        name: of the section, for errors.
        more: further arguments, already objects.

    Raises:
        ConfigError: it takes no such argument, lacks one, or one is not of its type.
    """
    if not isinstance(section, Mapping):
        raise ConfigError(f"{name}: '{_text(section)}' is not a section of keys")
    possible = [key for key in inspect.signature(kind).parameters if key not in more]
    for key in section:
        if key not in possible:
            raise ConfigError(f"{name}: no key '{key}'. {options(str(key), possible)}")
    check_types(kind, section, name)
    try:
        inspect.signature(kind).bind(**section, **more)
    except TypeError as error:
        raise ConfigError(f"{name}: {error}") from None
    return kind(**section, **more)


def check_types(kind: Any, values: Mapping[str, Any], name: str) -> None:
    """Refuse plain values, and lists of them, that are not of the types that a class's arguments have.

    What is told by no type, or by one that a config cannot hold, is left to the class.

    Args:
        kind: a class, or a function.
        values: its arguments, by name.
        name: of the section, for errors.

    Raises:
        ConfigError: the first that does not fit.
    """
    try:
        made_by = getattr(kind, "__init__") if isinstance(kind, type) else kind  # noqa: B009
        hints = typing.get_type_hints(made_by, include_extras=True)
    except (AttributeError, NameError, TypeError):  # names that only a type checker knows
        return
    for key, value in values.items():
        if key in hints and not _fits(value, hints[key]):
            raise ConfigError(f"{name}.{key}: '{_text(value)}' is not {type_text(hints[key])}")


def _fits(value: Any, hint: Any) -> bool:
    if hint in (Any, object):
        return True
    members = _members(hint)
    if len(members) > 1:
        return any(_fits(value, one) for one in members)
    if typing.get_origin(hint) is Annotated:
        plain, *ranges = typing.get_args(hint)
        return _fits(value, plain) and all(one.holds(value) for one in ranges)
    if hint is type(None):
        return value is None
    if hint in SAYS:
        return _is_plain(value, hint)
    inner = _inner(hint, value)
    if inner is not None:
        is_list = isinstance(value, list | tuple) and len(inner) == len(value)
        return is_list and all(_fits(one, its) for one, its in zip(value, inner, strict=True))
    if isinstance(value, Mapping) and _is_mapping(hint):
        return all(_fits(one, typing.get_args(hint)[1]) for one in value.values())
    return not isinstance(value, bool | int | float | str) or not _is_no_plain(hint)


def _is_mapping(hint: Any) -> bool:
    """Whether a type is a mapping whose values have a type."""
    kind = typing.get_origin(hint)
    is_mapping = isinstance(kind, type) and issubclass(kind, Mapping)
    return is_mapping and len(typing.get_args(hint)) == 2


def _members(hint: Any) -> tuple[Any, ...]:
    """Of a union, its types."""
    is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if is_union else (hint,)


def _inner(hint: Any, value: Any) -> Sequence[Any] | None:
    """The types of a sequence's items, as many as the value has or must have; None: it is no sequence."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if not (isinstance(origin, type) and issubclass(origin, Sequence)) or not inner:
        return None
    if origin is tuple and inner[-1] is not Ellipsis:
        return inner
    fewest = (
        0 if origin is list else 1
    )  # a sequence that nobody may leave empty is told as Sequence or tuple
    return [inner[0]] * max(fewest, len(value) if isinstance(value, list | tuple) else 1)


def _is_no_plain(hint: Any) -> bool:
    """Whether a type is an object's, a record's or a mapping's, which no number and no text is."""
    kind = typing.get_origin(hint) or hint
    return isinstance(kind, type) and kind not in SAYS


def _is_plain(value: Any, hint: type) -> bool:
    if hint is float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return is_number and math.isfinite(value)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is str:
        return isinstance(value, str | int | float) and not isinstance(value, bool)
    return isinstance(value, hint)


def type_text(hint: Any) -> str:
    """A type for people: ``a whole number of at least 1 or null``."""
    told = [one for one in map(_says_one, _members(hint)) if one]
    return " or ".join(told) or "a section of keys"


def _says_one(hint: Any) -> str:
    inner = typing.get_args(hint)
    if typing.get_origin(hint) is Annotated:
        return f"{type_text(inner[0]).replace('a finite', 'a')} {inner[1].says}"
    if hint is type(None):
        return "null"
    if hint in SAYS:
        return SAYS[hint]
    if _inner(hint, []) is None:
        return ""  # such as a tensor, which no config holds
    is_counted = typing.get_origin(hint) is tuple and inner[-1] is not Ellipsis
    return f"a list{f' of {len(inner)}' if is_counted else ''}, each {type_text(inner[0])}"


def _text(value: Any) -> str:
    names = {None: "null", True: "true", False: "false"}
    return names[value] if value is None or isinstance(value, bool) else str(value)
