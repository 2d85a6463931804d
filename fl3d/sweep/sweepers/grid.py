"""Every combination of swept values: all trials are known beforehand."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from fl3d.errors import ConfigError
from fl3d.sweep.sweepers.base import Compose, Point, Sweeper


class Listed(Sweeper):
    """All trials are given beforehand.

    Args:
        points: the trials.
    """

    def __init__(self, points: Sequence[Point]) -> None:
        self._points = points
        self.base = points[0].config if points else {}
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
    return Listed([Point(tuple(swept), compose([*fixed, *swept])) for swept in points])


def expand(params: Mapping[str, object], arguments: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Lay out a grid.

    Args:
        params: swept values by key, in Hydra's grammar, as a sweep file gives them.
        arguments: overrides of the command line; a key given there replaces the file's.

    Returns:
        overrides that every trial has, and those of each point of the grid; the first axis varies slowest.

    Raises:
        ConfigError: an interval, whose values cannot be listed.
    """
    parser = OverridesParser.create()
    given = parser.parse_overrides(list(arguments))
    named = {override.key_or_group for override in given}
    filed = parser.parse_overrides([f"{key}={value}" for key, value in params.items() if key not in named])
    fixed: list[str] = []
    axes: list[list[str]] = []
    for override in [*filed, *given]:
        if override.is_sweep_override():
            axes.append([f"{override.get_key_element()}={value}" for value in _strings(override)])
        elif override.input_line is not None and override.key_or_group in params:  # one value of what the file sweeps
            axes.append([override.input_line])
        elif override.input_line is not None:
            fixed.append(override.input_line)
    return fixed, [list(point) for point in itertools.product(*axes)]


def _strings(override: Override) -> list[str]:
    try:
        return list(override.sweep_string_iterator())
    except HydraException:
        raise ConfigError(
            f"'{override.input_line}': a grid needs values that can be listed, such as 0,1,2 or range(0,3); "
            "to search an interval add hydra/sweeper=optuna"
        ) from None


def values_of(override: str) -> list[object]:
    """The values of one override, swept or not: ``nms_iou=0.1,0.5`` -> [0.1, 0.5]."""
    parsed = OverridesParser.create().parse_override(override)
    value = parsed.value()
    if not parsed.is_sweep_override():
        return [value]
    return list(parsed.sweep_iterator())
