"""Every combination of swept values: all trials are known beforehand."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override

from fl3d.config.compose import values_by_key
from fl3d.core.records import Config
from fl3d.sweep.sweepers.base import Compose, Point, Sweeper


class Listed(Sweeper):
    """All trials are given beforehand.

    Args:
        points: the trials.
    """

    def __init__(self, points: Sequence[Point]) -> None:
        self._points = points
        self.base = points[0].config if points else {}
        self.swept = tuple(points[0].values) if points else ()
        self.n_trials = len(points)

    def first(self) -> Sequence[Point]:
        """All of them."""
        return self._points


def grid(params: Mapping[str, object], arguments: Sequence[str], compose: Compose) -> Listed:
    """The grid of a sweep file and the command line.

    Args:
        params: see ``expand``.
        arguments: see ``expand``.
        compose: makes a config of overrides.
    """
    fixed, points = expand(params, arguments)
    return Listed([point_of(overrides, compose([*fixed, *overrides])) for overrides in points])


def point_of(overrides: Sequence[str], config: Config) -> Point:
    """A point of overrides that each set one value."""
    values = {key: value for key, (value,) in values_by_key(overrides).items()}
    return Point(tuple(overrides), values, config)


def expand(
    params: Mapping[str, object], arguments: Sequence[str]
) -> tuple[list[str], list[list[str]]]:
    """Lay out a grid.

    Args:
        params: swept values by key, in Hydra's grammar, as a sweep file gives them.
        arguments: overrides of the command line; a key given there replaces the file's.

    Returns:
        overrides that every trial has, and those of each point of the grid; the first axis varies
        slowest.

    Raises:
        ConfigError: an interval, whose values cannot be listed.
    """
    parser = OverridesParser.create()
    given = parser.parse_overrides(list(arguments))
    named = {override.key_or_group for override in given}
    filed = parser.parse_overrides(
        [f"{key}={value}" for key, value in params.items() if key not in named]
    )
    fixed: list[str] = []
    axes: list[list[str]] = []
    for override in [*filed, *given]:
        if override.is_sweep_override():
            axes.append([f"{override.get_key_element()}={value}" for value in _strings(override)])
        elif override.input_line is not None and _is_value_of(override, params):
            axes.append([override.input_line])
        elif override.input_line is not None:
            fixed.append(override.input_line)
    return fixed, [list(point) for point in itertools.product(*axes)]


def _is_value_of(override: Override, params: Mapping[str, object]) -> bool:
    """Whether it sets one value of what the file sweeps: it still tells the trials from others."""
    return override.key_or_group in params and not override.is_delete()


def _strings(override: Override) -> list[str]:
    values_by_key([override.input_line or ""])  # an interval is refused there
    return list(override.sweep_string_iterator())
