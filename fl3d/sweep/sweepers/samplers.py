"""Optuna's samplers and pruners: made of their sections, and tried out before a study is opened."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution
from optuna.pruners import BasePruner, NopPruner
from optuna.samplers import BaseSampler

from fl3d.config.objects import build, locate
from fl3d.core.errors import ConfigError, Fl3dError
from fl3d.core.records import Config
from fl3d.sweep.sweepers.space import in_hydras_grammar, is_in, size, values

SAMPLER = "hydra.sweeper.sampler"
PRUNER = "hydra.sweeper.pruner"
GRID = optuna.samplers.GridSampler
BRUTE = optuna.samplers.BruteForceSampler
# These go through all points once, by what the study holds: another seed would begin another order.
ORDERED = (GRID, optuna.samplers.QMCSampler)
REHEARSED = 3  # points: CMA-ES needs its package for the second
Axes = Mapping[str, BaseDistribution]


class Samplers:
    """Makes the sampler that a section names.

    Args:
        section: with its ``_target_``.
        axes: what is searched.

    Raises:
        ConfigError: no sampler, one that does not take these arguments, or that cannot search these axes.
    """

    def __init__(self, section: Config, axes: Axes) -> None:
        self.kind = _kind(section, BaseSampler, SAMPLER)
        base = section.get("base_sampler")
        self.inner = _kind(base, BaseSampler, f"{SAMPLER}.base_sampler") if base else self.kind
        self.axes = axes
        self.section = self._completed(section)
        self._fixed: Mapping[str, Any] = section.get("fixed_params") or {}
        self._check_fixed()
        if self.inner is BRUTE:
            self._check_finite()

    @property
    def is_exhaustive(self) -> bool:
        """Whether it goes through all points of a finite space and then ends."""
        return self.inner in (GRID, BRUTE)

    @property
    def n_points(self) -> int | None:
        """How many points there are to go through; None: it does not end by itself."""
        if self.inner is GRID:
            counts = {key: len(points) for key, points in self._inner["search_space"].items()}
        elif self.inner is BRUTE:
            counts = {key: size(axis) or 0 for key, axis in self.axes.items()}
        else:
            return None
        return math.prod(count for key, count in counts.items() if key not in self._fixed)

    def holds(self, params: Mapping[str, Any]) -> bool:
        """Whether a point is one of those that it goes through."""
        if not set(params) >= set(self.axes):
            return False
        if any(params[key] != value for key, value in self._fixed.items()):
            return False
        if self.inner is GRID:
            return all(params[key] in own for key, own in self._inner["search_space"].items())
        return all(is_in(axis, params[key]) for key, axis in self.axes.items())

    @property
    def seed(self) -> int | None:
        """The seed that it is made with at the first start."""
        seed: int | None = self._inner.get("seed")
        return seed

    @property
    def _inner(self) -> Config:
        """The section of the sampler that proposes."""
        inner: Config = self.section.get("base_sampler") or self.section
        return inner

    def make(self, n_asked: int, first_seed: int | None) -> BaseSampler:
        """The sampler of one start.

        Args:
            n_asked: trials that the study holds: the same seed again would propose the first trials again.
            first_seed: of the study's first start.

        Raises:
            ConfigError: its own constructor refuses its arguments.
        """
        if self.inner in ORDERED:
            section = _with_seed(self.section, lambda _: first_seed)
        else:
            section = _with_seed(self.section, lambda seed: seed + n_asked)
        return _made(section, SAMPLER)

    def rehearse(self, directions: Sequence[Any], pruner: BasePruner) -> None:
        """Let it propose a few points in memory: what it cannot search or lacks shows now, and leaves no trial.

        Raises:
            ConfigError: naming the sampler and what it says.
        """
        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        sampler = self.make(0, self.seed)
        study = optuna.create_study(directions=directions, sampler=sampler, pruner=pruner)
        n_points = self.n_points or REHEARSED
        try:
            for number in range(min(REHEARSED, n_points)):
                trial = study.ask(dict(self.axes))
                if number + 1 < n_points:  # an exhaustive one complains after its last
                    study.tell(trial, [float(number)] * len(directions))
        except ImportError as error:
            raise ConfigError(
                f"{SAMPLER}: {self.inner.__name__} needs a package that is not installed: pip install {error.name}"
            ) from None
        except Exception as error:
            raise ConfigError(
                f"{SAMPLER}: {self.inner.__name__} cannot search "
                f"{', '.join(f'{key}={in_hydras_grammar(axis)}' for key, axis in self.axes.items())}: {error}"
            ) from None
        finally:
            optuna.logging.set_verbosity(verbosity)

    def _completed(self, section: Config) -> Config:
        """A section with what its sampler asks for and the config knows."""
        own = dict(section)
        if own.get("base_sampler"):
            base = dict(own["base_sampler"])
            base.setdefault("seed", own.get("seed"))
            own["base_sampler"] = self._of_kind(base, self.inner)
        return self._of_kind(own, self.kind)

    def _of_kind(self, section: Config, kind: type) -> Config:
        own = dict(section)
        taken = inspect.signature(kind).parameters.values()
        takes_any = any(one.kind is one.VAR_KEYWORD for one in taken)
        if not takes_any and not any(one.name == "seed" for one in taken):
            own.pop("seed", None)  # the default config gives one to whatever sampler
        if own.get("seed") is not None:
            _check_seed(own["seed"])
        if kind is GRID:
            own["search_space"] = self._grid(own.get("search_space"))
        return own

    def _grid(self, points: Any) -> dict[str, list[Any]]:
        """The points of each axis: those given, or all that it has.

        Raises:
            ConfigError: an axis without an end of them, or points that it does not have.
        """
        where = f"{SAMPLER}.search_space"
        if points is None:
            found = {key: values(axis) for key, axis in self.axes.items()}
            for key, own in found.items():
                if own is None:
                    raise ConfigError(
                        f"{where}: {key}={in_hydras_grammar(self.axes[key])} has no end of values; give a grid of "
                        f"each, such as {where}={{{key}:[0,1,2]}}, or search a choice or a range"
                    )
            return {key: list(own or ()) for key, own in found.items()}
        if not isinstance(points, Mapping) or set(points) != set(self.axes):
            raise ConfigError(
                f"{where}: give a list of values for each of {', '.join(self.axes)}, and for nothing else"
            )
        for key, own in points.items():
            if isinstance(own, str) or not isinstance(own, Sequence) or not own:
                raise ConfigError(f"{where}: {key}: {own} is no list of values")
            outside = next((value for value in own if not is_in(self.axes[key], value)), None)
            if outside is not None:
                raise ConfigError(
                    f"{where}: {key}={outside} is outside of what is searched, {in_hydras_grammar(self.axes[key])}"
                )
        # As Optuna keeps them: 1 of an axis of floats is 1.0.
        return {
            key: [_as_kept(self.axes[key], value) for value in dict.fromkeys(own)]
            for key, own in points.items()
        }

    def _check_fixed(self) -> None:
        for key, value in self._fixed.items():
            if key not in self.axes:
                raise ConfigError(
                    f"{SAMPLER}.fixed_params: {key} is not searched; those are {', '.join(self.axes)}"
                )
            if not is_in(self.axes[key], value):
                raise ConfigError(
                    f"{SAMPLER}.fixed_params: {key}={value} is outside of what is searched, "
                    f"{in_hydras_grammar(self.axes[key])}"
                )

    def _check_finite(self) -> None:
        for key, axis in self.axes.items():
            if size(axis) is None and key not in self._fixed:
                raise ConfigError(
                    f"{SAMPLER}: BruteForceSampler tries every point, and {key}={in_hydras_grammar(axis)} has no end "
                    f"of them; search a choice or a range, such as {key}=range(0,5,0.5)"
                )


def make_pruner(section: Mapping[str, Any] | None) -> BasePruner:
    """The pruner that a section names; None: none prunes.

    Raises:
        ConfigError: no pruner, or one that does not take these arguments.
    """
    if not section:
        return NopPruner()
    _kind(section, BasePruner, PRUNER)
    pruner: BasePruner = _made(dict(section), PRUNER)
    return pruner


def _kind(section: Any, base: type, where: str) -> type:
    """The class that a section names."""
    if not isinstance(section, Mapping) or not isinstance(section.get("_target_"), str):
        raise ConfigError(f"{where}: {section} names no class; give {where}._target_")
    kind = locate(section["_target_"], where)
    if not (isinstance(kind, type) and issubclass(kind, base)):
        raise ConfigError(
            f"{where}: {section['_target_']} is none of Optuna's {base.__name__.removeprefix('Base').lower()}s"
        )
    return kind


def _made(section: Config, where: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return build(section, where)
    except Fl3dError:
        raise
    except Exception as error:  # whatever a constructor of anybody's says of its arguments
        raise ConfigError(f"{where}: {section['_target_']}: {error}") from None


def _check_seed(seed: Any) -> None:
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**31:
        raise ConfigError(f"{SAMPLER}.seed: {seed} is not a whole number of at least 0, nor null")


def _with_seed(section: Mapping[str, Any], change: Any) -> Config:
    """A section whose seeds, also of the samplers within, are changed."""
    own = {
        key: _with_seed(v, change) if isinstance(v, Mapping) else v for key, v in section.items()
    }
    if "_target_" in own and own.get("seed") is not None:
        own["seed"] = change(own["seed"])
    return own


def _as_kept(axis: BaseDistribution, value: Any) -> Any:
    if isinstance(axis, CategoricalDistribution):
        return value
    return float(value) if isinstance(axis, FloatDistribution) else int(value)
