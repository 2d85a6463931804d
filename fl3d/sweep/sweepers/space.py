"""A search space in Hydra's override grammar, as Optuna's distributions."""

from __future__ import annotations

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
)
from optuna.trial import FrozenTrial

from fl3d.config.overrides import parse, same_key
from fl3d.core.errors import ConfigError
from fl3d.runs.design import SEED

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

    def overrides(self, trial: FrozenTrial) -> tuple[str, ...]:
        """A trial's point as overrides."""
        return tuple(f"{key}={trial.params[key]}" for key in self.axes)


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
        raise ConfigError(
            "seeds=N: a study trains each of its trials under one seed, not under N; for a seed drawn with the other "
            "values give 'seed=choice(0,1,2)', and to compare levels over seeds run a grid"
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
    is_log = "log" in sweep.tags
    is_int = "int(" in (override.input_line or "")
    if is_int and isinstance(sweep.start, int) and isinstance(sweep.end, int):
        return IntDistribution(sweep.start, sweep.end, log=is_log)
    return FloatDistribution(float(sweep.start), float(sweep.end), log=is_log)


def _range(sweep: RangeSweep) -> BaseDistribution:
    """Hydra's ranges leave their end out; Optuna's include it."""
    assert sweep.start is not None
    assert sweep.stop is not None
    if isinstance(sweep.start, int) and isinstance(sweep.stop, int) and isinstance(sweep.step, int):
        last = range(sweep.start, sweep.stop, sweep.step)[-1]
        return IntDistribution(sweep.start, last, step=sweep.step)
    count = int((sweep.stop - sweep.start) / sweep.step - 1e-9)
    last_float = float(sweep.start + count * sweep.step)
    return FloatDistribution(float(sweep.start), last_float, step=float(sweep.step))
