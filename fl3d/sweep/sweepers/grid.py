"""Every combination of swept values: all trials are known beforehand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.override_parser.types import Override

from fl3d.config.overrides import chooses_group, parse, plain_values, same_key, typed_words
from fl3d.core.counting import counted
from fl3d.core.errors import ConfigError
from fl3d.core.nested import has_key, value_at
from fl3d.core.records import Config
from fl3d.sweep.sweepers.base import Compose, Point, Sweeper

MOST_POINTS = 100_000  # of a grid: more are a slip


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


@dataclass(frozen=True)
class Grid:
    """The words of a sweep, laid out.

    Args:
        words: of the file, then of the command line, in their order: all that a word sets in turn. Hydra sets keys in
            this order, so that a later word overrules an earlier one.
        swept: numbers of the words that tell trials from each other.
    """

    words: tuple[tuple[str, ...], ...]
    swept: tuple[int, ...]

    @property
    def fixed(self) -> list[str]:
        """What all trials have."""
        return [word for number, (word, *_) in enumerate(self.words) if number not in self.swept]

    @property
    def points(self) -> list[tuple[str, ...]]:
        """What each trial has of its own; the first word varies slowest."""
        return list(itertools.product(*(self.words[number] for number in self.swept)))

    def whole(self, point: Sequence[str]) -> list[str]:
        """All that a trial has, in the order of the words."""
        own = dict(zip(self.swept, point, strict=True))
        return [own.get(number, word) for number, (word, *_) in enumerate(self.words)]


def grid(params: Mapping[str, object], arguments: Sequence[str], compose: Compose) -> Listed:
    """The grid of a sweep file and the command line.

    Args:
        params: see ``expand``.
        arguments: see ``expand``.
        compose: makes a config of overrides.
    """
    laid = expand(params, arguments)
    points = []
    with counted("composing", len(laid.points), "trial") as advance:
        for own in laid.points:
            points.append(point_of(own, compose(laid.whole(own))))
            advance(1)
    return Listed(points)


def point_of(overrides: Sequence[str], config: Config) -> Point:
    """A point of overrides that each set one value.

    Of several that set one key the last is kept; its value is the config's, where a later word of another key, such as
    a section, overrules it. Words that delete a key tell nothing of a trial.
    """
    last = {override.key_or_group: override for override in map(parse, overrides)}
    kept = {key: override for key, override in last.items() if not override.is_delete()}
    values = {key: _composed(key, override, config) for key, override in kept.items()}
    return Point(tuple(str(one.input_line) for one in kept.values()), values, config)


def _composed(key: str, override: Override, config: Config) -> Any:
    """The value that a config has of what an override sets; of groups and sections what was typed."""
    (typed,) = plain_values(override)
    if chooses_group(override) or not has_key(config, key) or isinstance(typed, Mapping):
        return typed
    found = value_at(config, key)
    return typed if isinstance(found, Mapping) else found


def expand(params: Mapping[str, object], arguments: Sequence[str]) -> Grid:
    """Lay out a grid.

    Args:
        params: swept values by key, in Hydra's grammar, as a sweep file gives them.
        arguments: overrides of the command line; a key given there replaces the file's.

    Raises:
        ConfigError: an interval, whose values cannot be listed, a key that is swept twice, or too many trials.
    """
    given = [parse(line) for line in arguments]
    filed = [parse(f"{key}={'null' if value is None else value}") for key, value in params.items()]
    named, of_file = ({same_key(one) for one in some} for some in (given, filed))
    words: list[tuple[str, ...]] = []
    swept: dict[str, int] = {}
    for override, overruled in _with_fate(
        [one for one in filed if same_key(one) not in named] + given
    ):
        key = same_key(override)
        if overruled and chooses_group(override):
            continue  # Hydra takes the last
        values = typed_words(override)
        # A word of what the file sweeps tells the trials from others, also where it sets one value.
        is_axis = override.is_sweep_override() or (key in of_file and not override.is_delete())
        if is_axis and not overruled:
            if key in swept:
                raise ConfigError(f"{override.input_line}: {key} is swept twice; keep one")
            swept[key] = len(words)
        words.append(values if is_axis and not overruled else values[:1])
    count = math.prod(len(words[number]) for number in swept.values())
    if count > MOST_POINTS:
        raise ConfigError(f"{' and '.join(swept)}: {count} trials, and {MOST_POINTS} are the most")
    return Grid(tuple(words), tuple(swept.values()))


def _with_fate(overrides: Sequence[Override]) -> Iterator[tuple[Override, bool]]:
    """Overrides, and whether a later one sets the same key, or deletes it; a section is merged into one before."""
    for number, override in enumerate(overrides):
        later = (one for one in overrides[number + 1 :] if same_key(one) == same_key(override))
        yield override, any(one.is_delete() or not _sets_section(one) for one in later)


def _sets_section(override: Override) -> bool:
    return any(isinstance(value, Mapping) for value in plain_values(override))
