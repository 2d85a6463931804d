"""A search space in Hydra's override grammar, as Optuna's distributions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.override_parser.types import (
    ChoiceSweep,
    IntervalSweep,
    Override,
    RangeSweep,
    Transformer,
)
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    check_distribution_compatibility,
)

from fl3d.config.overrides import parse, same_key
from fl3d.core.errors import ConfigError
from fl3d.runs.design import SEED

GOLDEN = 0.618
GRAMMAR = (
    "interval(0,5), tag(log,interval(0.01,1)), int(interval(1,8)), range(0,10,2), "
    "choice(a,b) or a,b"
)


@dataclass(frozen=True)
class Space:
    """What a study searches.

    Args:
        fixed: overrides that all trials have.
        axes: distributions by key, as written, such as ``loss.gamma`` or
            ``+schedule.stages.focal.set.loss.alpha``.
    """

    fixed: tuple[str, ...]
    axes: Mapping[str, BaseDistribution]

    def overrides(self, params: Mapping[str, Any]) -> tuple[str, ...]:
        """A point as overrides."""
        return tuple(f"{key}={params[key]}" for key in self.axes)

    def written(self, key: str) -> str:
        """What is searched of a key, in Hydra's grammar."""
        return in_hydras_grammar(self.axes[key])

    def ordered_as(self, keys: Sequence[str]) -> Space:
        """The same space, its axes in the order that a study knows them by."""
        return Space(
            self.fixed, {key: self.axes[key] for key in keys if key in self.axes} | dict(self.axes)
        )

    def examples(self) -> list[dict[str, Any]]:
        """A few points that hold each choice at least once, and of numbers one from between the bounds."""
        choices = [a.choices for a in self.axes.values() if isinstance(a, CategoricalDistribution)]
        count = max((len(one) for one in choices), default=1)
        return [{key: _example(axis, n) for key, axis in self.axes.items()} for n in range(count)]


def parse_space(params: Mapping[str, object], arguments: Sequence[str]) -> Space:
    """Read a search space.

    Args:
        params: values by key, in Hydra's grammar, as a sweep file gives them.
        arguments: overrides of the command line; a key given there replaces the file's.

    Raises:
        ConfigError: nothing is searched, or a sweep that no distribution stands for.
    """
    given = [parse(line) for line in arguments]
    named = {same_key(override) for override in given}
    filed = [parse(f"{key}={'null' if value is None else value}") for key, value in params.items()]
    fixed: list[str] = []
    axes: dict[str, BaseDistribution] = {}
    axis_of: dict[str, str] = {}
    for override in [*(o for o in filed if same_key(o) not in named), *given]:
        if same_key(override) in axis_of:  # a later word of the same key overrules
            del axes[axis_of.pop(same_key(override))]
        if override.is_sweep_override():
            _refuse_counted_seeds(override)
            axis_of[same_key(override)] = override.get_key_element()
            axes[override.get_key_element()] = _distribution(override)
        elif override.input_line is not None:
            fixed.append(override.input_line)
    if not axes:
        raise ConfigError(f"hydra.sweeper.params: nothing to search. Give KEY: {GRAMMAR}")
    return Space(tuple(fixed), axes)


def _refuse_counted_seeds(override: Override) -> None:
    """Seeds have no order, and ``seeds=3`` would mean all three of each trial."""
    if override.key_or_group == SEED and not override.is_choice_sweep():
        typed = override.input_line if override.is_interval_sweep() else "seeds=N"
        raise ConfigError(
            f"{typed}: a study trains each of its trials under one seed, and seeds have no order; for a seed "
            "drawn with the other values give 'seed=choice(0,1,2)', and to compare levels over seeds run a grid"
        )


def _distribution(override: Override) -> BaseDistribution:
    value: Any = override.value()
    where = f"'{override.input_line}'"
    try:
        if isinstance(value, IntervalSweep):
            return _interval(value, override)
        if isinstance(value, RangeSweep):
            return _range(value)
        if isinstance(value, ChoiceSweep):
            choices: list[Any] = list(override.sweep_iterator(transformer=_as_written))
            return CategoricalDistribution(choices)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{where}: {error}") from None
    raise ConfigError(f"{where}: not a search space. Possible: {GRAMMAR}")


def _as_written(value: Any) -> Any:
    """A choice that Optuna can keep: a number, or the text that stands for it in an override."""
    return value if isinstance(value, bool | int | float) else Transformer.str(value)


def _interval(sweep: IntervalSweep, override: Override) -> BaseDistribution:
    assert sweep.start is not None
    assert sweep.end is not None
    if not (math.isfinite(sweep.start) and math.isfinite(sweep.end)):
        raise ValueError("an interval needs two numbers as its ends")
    is_log = "log" in sweep.tags
    is_int = "int(" in (override.input_line or "")
    if is_int and isinstance(sweep.start, int) and isinstance(sweep.end, int):
        return IntDistribution(sweep.start, sweep.end, log=is_log)
    return FloatDistribution(float(sweep.start), float(sweep.end), log=is_log)


def _range(sweep: RangeSweep) -> BaseDistribution:
    """Hydra's ranges leave their end out; Optuna's include it."""
    assert sweep.start is not None
    assert sweep.stop is not None
    if not sweep.step > 0:
        raise ValueError(f"its step is {sweep.step}, and a study goes upwards: give one above 0")
    if not sweep.start < sweep.stop:
        raise ValueError("it holds no value: a range leaves its end out")
    if isinstance(sweep.start, int) and isinstance(sweep.stop, int) and isinstance(sweep.step, int):
        last = range(sweep.start, sweep.stop, sweep.step)[-1]
        return IntDistribution(sweep.start, last, step=sweep.step)
    count = int((sweep.stop - sweep.start) / sweep.step - 1e-9)
    last_float = float(sweep.start + count * sweep.step)
    return FloatDistribution(float(sweep.start), last_float, step=float(sweep.step))


def in_hydras_grammar(axis: BaseDistribution) -> str:
    """A distribution as it is typed."""
    if isinstance(axis, CategoricalDistribution):
        return f"choice({','.join(map(str, axis.choices))})"
    assert isinstance(axis, FloatDistribution | IntDistribution)
    is_int = isinstance(axis, IntDistribution)
    if axis.step is not None and not (is_int and axis.step == 1):
        return f"range({axis.low},{_plus(axis.high, axis.step)},{axis.step})"
    low, high = (int(end) if float(end).is_integer() else end for end in (axis.low, axis.high))
    text = f"interval({low},{high})"
    if axis.log:
        text = f"tag(log,{text})"
    return f"int({text})" if is_int else text


def _plus(high: float, step: float) -> float:
    """The end of a range, which Hydra leaves out."""
    return round(high + step, 12)


def is_in(axis: BaseDistribution, value: Any) -> bool:
    """Whether an axis holds a value."""
    try:
        return axis._contains(axis.to_internal_repr(value))
    except (ValueError, TypeError):
        return False


def size(axis: BaseDistribution) -> int | None:
    """How many values an axis has; None: no end of them."""
    if isinstance(axis, CategoricalDistribution):
        return len(axis.choices)
    assert isinstance(axis, FloatDistribution | IntDistribution)
    return None if axis.step is None else round((axis.high - axis.low) / axis.step) + 1


def values(axis: BaseDistribution) -> list[Any] | None:
    """All values of an axis; None: there is no end of them."""
    count = size(axis)
    if count is None:
        return None
    if isinstance(axis, CategoricalDistribution):
        return list(axis.choices)
    assert isinstance(axis, FloatDistribution | IntDistribution)
    assert axis.step is not None
    return [_plus(axis.low, n * axis.step) for n in range(count)]


def _example(axis: BaseDistribution, number: int) -> Any:
    if isinstance(axis, CategoricalDistribution):
        return axis.choices[number % len(axis.choices)]
    assert isinstance(axis, FloatDistribution | IntDistribution)
    if isinstance(axis, IntDistribution) or axis.step is not None:
        return axis.low
    # Not in the middle, which may be a whole number by chance.
    return axis.low + GOLDEN * (axis.high - axis.low)


def change_of(before: BaseDistribution, now: BaseDistribution) -> str:
    """How an axis differs from what a study was begun with, so that Optuna cannot go on; empty: it can.

    Bounds and steps may change.
    """
    try:
        check_distribution_compatibility(before, now)
    except ValueError:
        return f"was {in_hydras_grammar(before)} and is {in_hydras_grammar(now)}"
    return ""
