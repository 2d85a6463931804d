"""Points of a sweep that stand for what a study proposes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial

from fl3d.core.errors import ConfigError
from fl3d.sweep.sweepers.base import Compose, Point
from fl3d.sweep.sweepers.grid import point_of
from fl3d.sweep.sweepers.space import Space, in_hydras_grammar, is_in


class Points:
    """A space, and the points in it.

    Args:
        space: what is searched.
        compose: makes a config of overrides.
        identify: the key of a point's trial.
    """

    def __init__(self, space: Space, compose: Compose, identify: Callable[[Point], str]) -> None:
        self.space = space
        self.compose = compose
        self.identify = identify

    @property
    def axes(self) -> Mapping[str, BaseDistribution]:
        """What is searched, by key."""
        return self.space.axes

    def of(self, params: Mapping[str, Any]) -> Point:
        """The point of a trial's values."""
        overrides = self.space.overrides(params)
        return point_of(overrides, self.compose([*self.space.fixed, *overrides]))

    def is_whole(self, params: Mapping[str, Any]) -> bool:
        """Whether a trial has a value on every axis."""
        return set(params) >= set(self.axes)

    def outside(self, params: Mapping[str, Any]) -> list[str]:
        """Axes that do not hold a trial's value, of those that it has one on."""
        return [k for k, axis in self.axes.items() if k in params and not is_in(axis, params[k])]

    def order_as(self, trials: Sequence[FrozenTrial]) -> None:
        """Take the order of a study's axes: samplers that go through a space know them by it."""
        begun = [trial for trial in trials if set(trial.params) == set(self.axes)]
        if begun:
            self.space = self.space.ordered_as(list(begun[0].params))

    def try_examples(self) -> None:
        """Refuse now what would be refused when it is proposed, with trials in training beside it.

        Raises:
            ConfigError: a value that cannot be trained.
        """
        for params in self.space.examples():
            try:
                self.identify(self.of(params))
            except ConfigError as error:
                raise ConfigError(f"{error}{self._whole_numbers(str(error))}") from None

    def _whole_numbers(self, error: str) -> str:
        """How to propose whole numbers, where an error is about an axis of any."""
        for key, axis in self.axes.items():
            if not isinstance(axis, FloatDistribution) or axis.step is not None:
                continue
            if error.startswith(f"{key.lstrip('+')}:"):
                whole = IntDistribution(math.ceil(axis.low), math.floor(axis.high), log=axis.log)
                return (
                    f"; {key}={in_hydras_grammar(axis)} proposes any number: "
                    f"for whole ones give '{key}={in_hydras_grammar(whole)}'"
                )
        return ""
