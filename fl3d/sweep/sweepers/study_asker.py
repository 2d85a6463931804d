"""Asks a study for the points to train next."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import FrozenTrial, TrialState

from fl3d.core.errors import ConfigError, Fl3dError
from fl3d.sweep.sweepers.base import Point, Standing
from fl3d.sweep.sweepers.samplers import SAMPLER
from fl3d.sweep.sweepers.study_left import Left
from fl3d.sweep.sweepers.study_report import KEY
from fl3d.sweep.sweepers.study_teller import Teller
from fl3d.sweep.sweepers.study_trials import SOURCE, counts

MAX_FAILED = 3  # trials that fail before any is done: then something is wrong with all of them


class Asker:
    """Asks for points, those first that were left without.

    Args:
        left: what was taken up.
        teller: is told whom to expect, and knows what was told.
        n_trials: how many are asked for, over all starts.
        say: prints a line for the user.
    """

    def __init__(
        self, left: Left, teller: Teller, n_trials: int, say: Callable[[str], None]
    ) -> None:
        self.trials, self.points, self.samplers = left.trials, left.points, left.samplers
        self._unbegun = left.unbegun
        self.teller = teller
        self.n_trials = n_trials
        self.say = say

    def may_ask(self) -> bool:
        """Whether one more is wanted, and there is one."""
        if self.teller.failed >= MAX_FAILED and not self.teller.done:
            return False
        if self._unbegun:
            return True
        trials = self.trials.all()
        if sum(map(counts, trials)) + self.teller.failed >= self.n_trials:
            return False
        return any(map(_waits_with_point, trials)) or not self.is_exhausted()

    def is_exhausted(self) -> bool:
        """Whether there is nothing left to propose: all points of a grid were, or the sampler says so."""
        n_points = self.samplers.n_points
        if n_points is None or self.trials.is_stopped:
            return self.trials.is_stopped
        tried = {
            tuple(trial.params[key] for key in self.points.axes)
            for trial in self.trials.all()
            if self.samplers.holds(trial.params)
        }
        return len(tried) >= n_points

    def ask(self, standings: Mapping[str, Standing]) -> Point | None:
        """A point to train, or None where its trial is known or not wanted."""
        trial = self._begin()
        if trial is None:
            return None
        try:
            self._suggest(trial)
            # As kept: 0 of floats is 0.0.
            point = self.points.of(self.trials.all()[trial.number].params)
            key = self.points.identify(point)
            trial.set_user_attr(KEY, key)
        except UpdateFinishedTrialError:  # somebody else has told it just now
            return None
        except BaseException:
            self._withdraw(trial)
            raise
        if self._tell_as_twin(trial, key):
            return None
        self.teller.expect(trial.number, key)
        return None if key in standings else point

    def _tell_as_twin(self, trial: optuna.Trial, key: str) -> bool:
        """Tell a trial what one of the same point has come to; whether there is such a one."""
        twin = self.teller.known.get(key)
        if twin is None or twin.state is TrialState.FAIL:
            return False
        trial.set_user_attr(SOURCE, twin.number)
        self.trials.tell(trial.number, twin.state, twin.values)
        return True

    def _begin(self) -> optuna.Trial | None:
        """A trial without a point: one that was left, one that waits, or a new one.

        It is the sweep's from the first line that is written of it, so that nobody takes it for a stranger's.
        """
        left = self._unbegun
        trial = self.trials.opened(left.pop(0)) if left else self.trials.next()
        try:
            for name, value in self.trials.own.items():
                if trial.user_attrs.get(name) != value:
                    trial.set_user_attr(name, value)
        except UpdateFinishedTrialError:  # another sweep took it for one that was left
            return None
        return trial if self._is_wanted(trial) else None

    def _is_wanted(self, trial: optuna.Trial) -> bool:
        """Whether a trial fits the space and the number of trials; else it is told as failed."""
        trials = self.trials.all()
        counted = sum(one.state is not TrialState.FAIL for one in trials[: trial.number])
        if counted + self.teller.failed >= self.n_trials:  # another sweep asked at the same moment
            self._withdraw(trial)
            return False
        fixed = trials[trial.number].system_attrs.get("fixed_params", {})
        for key in self.points.outside(fixed):
            self.say(
                f"The study '{self.trials.name}' was to ask {key}={fixed[key]}, which is outside of "
                f"{self.points.space.written(key)}: left out."
            )
            self._withdraw(trial)
            return False
        return True

    def _suggest(self, trial: optuna.Trial) -> None:
        """Let the sampler choose a trial's point.

        Raises:
            ConfigError: it cannot.
        """
        try:
            for key, axis in self.points.axes.items():
                _suggest(trial, key, axis)
        except (UpdateFinishedTrialError, Fl3dError):
            raise
        except Exception as error:
            raise ConfigError(
                f"{SAMPLER}: {self.samplers.inner.__name__} cannot go on with the study '{self.trials.name}': {error}; "
                "give another sampler or hydra.sweeper.study_name"
            ) from error

    def _withdraw(self, trial: optuna.Trial) -> None:
        """Let go of a trial that is not trained: it shall not count. Where a kill comes first, the next start does."""
        if self.points.is_whole(trial.params) or not self.samplers.is_exhaustive:
            with contextlib.suppress(Exception):
                self.trials.tell(trial.number, TrialState.FAIL)


def _waits_with_point(trial: FrozenTrial) -> bool:
    return trial.state is TrialState.WAITING and "fixed_params" in trial.system_attrs


def _suggest(trial: optuna.Trial, key: str, axis: BaseDistribution) -> None:
    if isinstance(axis, CategoricalDistribution):
        trial.suggest_categorical(key, axis.choices)
    elif isinstance(axis, IntDistribution):
        trial.suggest_int(key, axis.low, axis.high, step=axis.step, log=axis.log)
    elif isinstance(axis, FloatDistribution):
        trial.suggest_float(key, axis.low, axis.high, step=axis.step, log=axis.log)
