"""What a detector is told of each class by itself: ``detector.per_class.NAME``; its plain keys are those of cars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fl3d.core.errors import ConfigError
from fl3d.data.classes import CARS

PerClass = Mapping[str, Mapping[str, Any]]
KEY = "detector.per_class"


def own_section(
    per_class: PerClass | None, name: str, possible: Sequence[str]
) -> Mapping[str, Any]:
    """What is told of a class; nothing where nothing is.

    Args:
        per_class: by class.
        name: of the class.
        possible: keys that the detector reads.

    Raises:
        ConfigError: another key.
    """
    section = (per_class or {}).get(name) or {}
    for key in section:
        if key not in possible:
            raise ConfigError(
                f"{KEY}.{name}.{key}: no key that anything reads. Possible: {', '.join(possible)}"
            )
    return section


def least_points(per_class: PerClass | None, classes: Sequence[str]) -> dict[str, int]:
    """Points that a training target must hold, of those classes that have a number of their own.

    Raises:
        ConfigError: it is no whole number of at least 0.
    """
    found = {name: (per_class or {}).get(name, {}).get("min_points") for name in classes}
    for name, least in found.items():
        if least is not None and (
            not isinstance(least, int) or isinstance(least, bool) or least < 0
        ):
            raise ConfigError(
                f"{KEY}.{name}.min_points: '{least}' is not a whole number of at least 0"
            )
    return {name: least for name, least in found.items() if least is not None}


def further_sizes(
    classes: Sequence[str], known: Sequence[str], per_class: PerClass | None
) -> dict[str, Sequence[float]]:
    """Mean h, w, l in metres of those classes that are none of the known.

    Raises:
        ConfigError: a class has none.
    """
    found = {}
    for name in classes:
        section = own_section(per_class, name, ("size", "min_points"))
        if name not in known:
            found[name] = _size(name, section)
        elif "size" in section:
            raise ConfigError(f"{KEY}.{name}.size: detector.sizes has that of {name}")
    return found


def mean_size(name: str, plain: Sequence[float], per_class: PerClass | None) -> Sequence[float]:
    """Mean h, w, l of a class in metres; the plain one is that of cars.

    Raises:
        ConfigError: the class has none.
    """
    section = own_section(per_class, name, ("size", "min_points"))
    return plain if (name,) == CARS and "size" not in section else _size(name, section)


def _size(name: str, section: Mapping[str, Any]) -> Sequence[float]:
    if "size" not in section:
        raise needs(name, "size", "[2.6,2.2,7.0]", "mean height, width and length in metres")
    size = section["size"]
    is_list = isinstance(size, list | tuple) and len(size) == 3
    if not is_list or not all(isinstance(x, int | float) and x > 0 for x in size):
        raise ConfigError(
            f"{KEY}.{name}.size: {size} are not three numbers above 0, height, width, length"
        )
    return [float(x) for x in size]


def needs(name: str, key: str, example: str, what: str) -> ConfigError:
    """The error of a class that the detector knows nothing of."""
    return ConfigError(
        f"{KEY}.{name}.{key}: is not there, and classes name {name}; give +{KEY}.{name}.{key}={example}, {what}"
    )
