"""Trials by Optuna's ask and tell: same plan and launchers as a grid, pruned by checkpoints."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import FrozenTrial, create_trial
from optuna.trial import TrialState as OptunaState

from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError, Fl3dError, options
from fl3d.core.leases import holder_of
from fl3d.core.records import Config
from fl3d.runs.layout import StoreFolder
from fl3d.store.opening import open_store
from fl3d.sweep.sweepers.base import (
    Advice,
    Compose,
    Evidence,
    Point,
    Standing,
    Sweeper,
    TrialState,
)
from fl3d.sweep.sweepers.grid import point_of
from fl3d.sweep.sweepers.samplers import BRUTE, SAMPLER, Samplers, make_pruner
from fl3d.sweep.sweepers.space import Space, change_of, in_hydras_grammar, is_in, parse_space
from fl3d.sweep.sweepers.study_report import KEY, report_study
from fl3d.sweep.sweepers.study_settings import StudySettings
from fl3d.sweep.sweepers.study_storage import alone, experimental, open_storage, reached

# Attributes of a trial in the study, beside ``KEY``. The first two it has before anything else of it is written.
ROOT = "fl3d.store"  # where it is trained
SWEEP = "fl3d.sweep"  # by which sweep: its lease says whether that lives
SOURCE = "fl3d.value_of"  # the trial whose value it was told
SEED = "fl3d.sampler_seed"  # of the study: of its first start
MAX_FAILED = 3  # trials that fail before any is done: then something is wrong with all of them


class Study(Sweeper):
    """Asks an Optuna study for trials, as many at once as there are slots, and tells it their AP.

    A point that was proposed before is not trained again: it is told the same value. A trial that
    a dead sweep left running is told as failed, and its point is asked for again: its stages resume
    from their checkpoints. One that died before it had its point gets it now. Trials of sweeps that
    live, and of other stores, are left alone.

    Args:
        base: a config of the sweep.
        space: what is searched.
        compose: makes a config of overrides.
        settings: see ``StudySettings``.

    Raises:
        ConfigError: settings that cannot be used or do not go together.
    """

    listens = True

    def __init__(self, base: Config, space: Space, compose: Compose, **settings: Any) -> None:
        self.base = base
        self.settings = read_settings(base)
        self.asked = StudySettings(**settings)
        self.asked.check_with(self.settings, space)
        self.space = space
        self.swept = tuple(key.lstrip("+") for key in space.axes)
        self.compose = compose
        self.n_trials = self.asked.n_trials
        self.objectives = list(self.asked.objectives)
        named = self.asked.study_name
        self.name = self.settings.experiment if named is None else str(named)
        self._directions = [optuna.study.StudyDirection.MAXIMIZE] * len(self.objectives)
        default = {"_target_": "optuna.samplers.TPESampler", "seed": base["seed"]}
        self.samplers = Samplers(dict(self.asked.sampler or default), space.axes)
        self.samplers.rehearse(self._directions, make_pruner(self.asked.pruner))
        self._trials: dict[int, str] = {}  # of this start: the study's number, and our key
        self._heard: dict[int, set[int]] = {}
        self._known: dict[str, FrozenTrial] = {}  # told, by key
        self._earlier: list[Point] = []
        self._pruned: list[str] = []
        self._left: list[FrozenTrial] = []  # that died before they had their points
        self._notes: list[str] = []
        self._say: Callable[[str], None] = self._notes.append  # until the sweep can print
        self._is_stopped = False  # by its sampler
        self._failed = 0
        self._done = 0

    def first(self) -> Sequence[Point]:
        """None: what comes first depends on the study."""
        return ()

    def open(self, identify: Callable[[Point], str]) -> None:
        """Open the study, and take up what a dead sweep left.

        Raises:
            ConfigError: a value that would be proposed is refused, or the study was begun with other settings.
            StoreError: where it is kept is damaged or cannot be reached.
        """
        self._identify = identify
        self._try_examples()
        store = self.settings.store
        self._root = open_store(store.root, store.uri).id
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with reached(self.name), alone(store.root, self.name):
            self.study = self._open()
            self._take_up_all()
            if not self._all():
                for point in self.asked.enqueue:
                    self._enqueue(point)

    def consult(self, evidence: Evidence) -> None:
        """Say what was found in the study."""
        self._say = evidence.say
        for note in self._notes:
            evidence.say(note)
        self._notes.clear()

    def _try_examples(self) -> None:
        """Refuse now what would be refused when it is proposed, with trials in training beside it."""
        for params in self.space.examples():
            try:
                self._identify(self._point(params))
            except ConfigError as error:
                raise ConfigError(f"{error}{self._whole_numbers(str(error))}") from None

    def _whole_numbers(self, error: str) -> str:
        """How to propose whole numbers, where an error is about an axis of any."""
        for key, axis in self.space.axes.items():
            if not isinstance(axis, FloatDistribution) or axis.step is not None:
                continue
            if error.startswith(f"{key.lstrip('+')}:"):
                whole = IntDistribution(math.ceil(axis.low), math.floor(axis.high), log=axis.log)
                return (
                    f"; {key}={in_hydras_grammar(axis)} proposes any number: "
                    f"for whole ones give '{key}={in_hydras_grammar(whole)}'"
                )
        return ""

    def _take_up_all(self) -> None:
        trials = list(self._all())
        for trial in trials:
            self._check_axes(trial)
        begun = [trial for trial in trials if set(trial.params) == set(self.space.axes)]
        if begun:  # samplers that go through a space know its axes by their order
            self.space = self.space.ordered_as(list(begun[0].params))
        dead = 0
        for trial in trials:
            is_ours = trial.user_attrs.get(ROOT) == self._root
            if trial.state is OptunaState.RUNNING and self._is_dead(trial):
                self._begin_again(trial)
                dead += 1
            elif is_ours and trial.state in (OptunaState.COMPLETE, OptunaState.PRUNED):
                self._take_up(trial)
        if self.samplers.is_exhaustive:
            self._ask_failed_again()
        elsewhere = sum(trial.state is OptunaState.RUNNING for trial in trials) - dead
        if dead:
            self._say(
                f"The study '{self.name}' had {_count(dead)} that an interrupted start left running: asked for again."
            )
        if elsewhere:
            self._say(
                f"In the study '{self.name}' other sweeps or stores have {_count(elsewhere)} running, which count too."
            )

    def _is_dead(self, trial: FrozenTrial) -> bool:
        """Whether nobody trains a trial that the study calls running."""
        root = trial.user_attrs.get(ROOT)
        if root is None:  # Optuna's own ask, killed before it got its attributes
            return True
        own = self.settings.experiment
        sweep = trial.user_attrs.get(SWEEP, own)
        # This process holds the lease of its own sweep: nobody else can be training for that.
        layout = StoreFolder(self.settings.store.root)
        return root == self._root and (sweep == own or holder_of(layout.lease(sweep)) is None)

    def _begin_again(self, trial: FrozenTrial) -> None:
        """Ask for a dead trial's point again, or give it one."""
        is_whole = set(trial.params) >= set(self.space.axes)
        if not is_whole or self.samplers.is_exhaustive:
            self._left.append(trial)  # a grid would count it as tried if it were told as failed
            return
        if all(is_in(axis, trial.params[key]) for key, axis in self.space.axes.items()):
            self._enqueue(trial.params)
        self._tell(trial.number, OptunaState.FAIL)

    def _ask_failed_again(self) -> None:
        """A grid is whole when each of its points is done: those that failed are tried again, once a start."""
        failed: dict[tuple[Any, ...], FrozenTrial] = {}
        others: set[tuple[Any, ...]] = set()
        for trial in self._all():
            params = trial.system_attrs.get("fixed_params", trial.params)
            if not self.samplers.holds(params):
                continue
            point = tuple(params[key] for key in self.space.axes)
            if trial.state is OptunaState.FAIL:
                failed[point] = trial
            else:
                others.add(point)
        for point, trial in failed.items():
            if point not in others:
                self._enqueue(trial.params)

    def _enqueue(self, params: Mapping[str, Any]) -> None:
        self.study.enqueue_trial(dict(params), user_attrs=self._own)

    @property
    def _own(self) -> dict[str, Any]:
        """What every trial of this sweep carries."""
        return {ROOT: self._root, SWEEP: self.settings.experiment}

    def _check_axes(self, trial: FrozenTrial) -> None:
        """Refuse a space that a study cannot go on with.

        Raises:
            ConfigError: naming what was and what is.
        """
        axes, before = self.space.axes, trial.distributions
        is_ours = trial.user_attrs.get(ROOT) == self._root
        is_told = trial.state in (OptunaState.COMPLETE, OptunaState.PRUNED)
        changes = []
        if is_ours and is_told and set(before) != set(axes):
            changes = [f"it searched {', '.join(before)}, and this one {', '.join(axes)}"]
        for key in axes:
            change = change_of(before[key], axes[key]) if key in before else ""
            if (
                not change
                and self.samplers.inner is BRUTE
                and before.get(key, axes[key]) != axes[key]
            ):
                change = (
                    f"was {in_hydras_grammar(before[key])} and is {in_hydras_grammar(axes[key])}"
                )
            if change:
                changes.append(f"{key} {change}")
        if changes:
            raise ConfigError(
                f"hydra.sweeper.params: the study '{self.name}' was begun with another space: {'; '.join(changes)}. "
                "Give another hydra.sweeper.study_name (what both propose is not trained twice), or the space of before"
            )

    def _all(self) -> list[FrozenTrial]:
        """All trials of the study, whoever asked for them; to be read only."""
        return self.study.get_trials(deepcopy=False)

    def _take_up(self, trial: FrozenTrial) -> None:
        """Propose again what an earlier start has told: not trained, it belongs to the sweep."""
        point = self._point(trial.params)
        key = self._identify(point)
        if key != trial.user_attrs.get(KEY):
            raise ConfigError(
                f"the study '{self.name}' was begun with other data, versions or settings: "
                f"its trial {trial.number} was {trial.user_attrs.get(KEY)}, "
                f"and would be {key} now; give another hydra.sweeper.study_name"
            )
        self._known[key] = trial
        self._earlier.append(point)
        if trial.state is OptunaState.PRUNED:
            self._pruned.append(key)

    def _point(self, params: Mapping[str, Any]) -> Point:
        overrides = self.space.overrides(params)
        return point_of(overrides, self.compose([*self.space.fixed, *overrides]))

    def _open(self) -> optuna.Study:
        store = self.settings.store
        storage = open_storage(
            self.asked.storage, store.root, store.uri, name=self.name, say=self._say
        )
        with experimental():
            study = optuna.create_study(
                storage=storage,
                study_name=self.name,
                directions=self._directions,
                pruner=make_pruner(self.asked.pruner),
                load_if_exists=True,
            )
        self._check_attributes(study)
        study.sampler = self.samplers.make(
            len(study.get_trials(deepcopy=False)), study.user_attrs[SEED]
        )
        return study

    def _check_attributes(self, study: optuna.Study) -> None:
        """Refuse a study whose values mean something else; a new one remembers what its mean.

        Raises:
            ConfigError: naming what differs.
        """
        attributes: dict[str, object] = {
            "objectives": self.objectives,
            "rule": self.asked.rule,
            "protocol": self.settings.protocol.id,
        }
        for key, value in attributes.items():
            before = study.user_attrs.get(key, value)
            if before != value:
                raise ConfigError(
                    f"{key}: the study '{self.name}' was begun with {before}, not {value}; their "
                    "values cannot be compared; give another hydra.sweeper.study_name"
                )
        for key, value in {**attributes, SEED: self.samplers.seed}.items():
            if key not in study.user_attrs:
                study.set_user_attr(key, value)

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        """Tell what has ended, prune, and ask for as many trials as there are free slots.

        Raises:
            StoreError: the study cannot be read or written now.
        """
        with reached(self.name):
            return self._advise(standings, slots)

    def _advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        stop = self._pruned
        points = self._earlier
        self._pruned = []
        self._earlier = []
        for number, key in list(self._trials.items()):
            if self._hear(number, standings[key]):
                stop.append(key)
        while len(self._trials) < slots and self._may_ask():
            point = self._ask(standings)
            if point is not None:
                points.append(point)
        return Advice(points, stop)

    def _may_ask(self) -> bool:
        if self._failed >= MAX_FAILED and not self._done:
            return False
        if self._left:
            return True
        trials = self._all()
        if sum(map(_counts, trials)) + self._failed >= self.n_trials:
            return False
        is_waiting = any(
            trial.state is OptunaState.WAITING and "fixed_params" in trial.system_attrs
            for trial in trials
        )
        return is_waiting or not self._is_exhausted()

    def _is_exhausted(self) -> bool:
        """Whether there is nothing left to propose: all points of a grid were, or the sampler says so."""
        n_points = self.samplers.n_points
        if n_points is None or self._is_stopped:
            return self._is_stopped
        tried = {
            tuple(trial.params[key] for key in self.space.axes)
            for trial in self._all()
            if self.samplers.holds(trial.params)
        }
        return len(tried) >= n_points

    def _ask(self, standings: Mapping[str, Standing]) -> Point | None:
        """A point to train, or None where its trial is known or not wanted."""
        trial = self._begin()
        if trial is None:
            return None
        try:
            self._suggest(trial)
            point = self._point(self._all()[trial.number].params)  # as kept: 0 of floats is 0.0
            key = self._identify(point)
            trial.set_user_attr(KEY, key)
        except UpdateFinishedTrialError:  # somebody else has told it just now
            return None
        except BaseException:
            self._withdraw(trial)
            raise
        twin = self._known.get(key)
        if twin is not None and twin.state is not OptunaState.FAIL:
            trial.set_user_attr(SOURCE, twin.number)
            self._tell(trial.number, twin.state, twin.values)
            return None
        self._trials[trial.number] = key
        self._heard[trial.number] = set()
        return None if key in standings else point

    def _begin(self) -> optuna.Trial | None:
        """A trial without a point: one that was left, one that waits, or a new one.

        It is the sweep's from the first line that is written of it, so that nobody takes it for a stranger's.
        """
        if self._left:
            trial = optuna.trial.Trial(self.study, self._left.pop(0)._trial_id)
        else:
            if not any(one.state is OptunaState.WAITING for one in self._all()):
                self.study.add_trial(create_trial(state=OptunaState.WAITING, user_attrs=self._own))
            trial = self.study.ask()
        try:
            for name, value in self._own.items():
                if trial.user_attrs.get(name) != value:
                    trial.set_user_attr(name, value)
        except UpdateFinishedTrialError:  # another sweep took it for one that was left
            return None
        return trial if self._is_wanted(trial) else None

    def _is_wanted(self, trial: optuna.Trial) -> bool:
        """Whether a trial fits the space and the number of trials; else it is told as failed."""
        trials = self._all()
        counted = sum(one.state is not OptunaState.FAIL for one in trials[: trial.number])
        if counted + self._failed >= self.n_trials:  # another sweep asked at the same moment
            self._withdraw(trial)
            return False
        fixed = trials[trial.number].system_attrs.get("fixed_params", {})
        for key, axis in self.space.axes.items():
            if key in fixed and not is_in(axis, fixed[key]):
                self._say(
                    f"The study '{self.name}' was to ask {key}={fixed[key]}, which is outside of "
                    f"{in_hydras_grammar(axis)}: left out."
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
            for key, axis in self.space.axes.items():
                _suggest(trial, key, axis)
        except (UpdateFinishedTrialError, Fl3dError):
            raise
        except Exception as error:
            raise ConfigError(
                f"{SAMPLER}: {self.samplers.inner.__name__} cannot go on with the study '{self.name}': {error}; give "
                "another sampler or hydra.sweeper.study_name"
            ) from error

    def _withdraw(self, trial: optuna.Trial) -> None:
        """Let go of a trial that is not trained: it shall not count. Where a kill comes first, the next start does."""
        is_whole = set(trial.params) >= set(self.space.axes)
        if is_whole or not self.samplers.is_exhaustive:
            with contextlib.suppress(Exception):
                self._tell(trial.number, OptunaState.FAIL)

    def _hear(self, number: int, standing: Standing) -> bool:
        """Report and tell a trial; whether it shall be stopped."""
        if standing.state is TrialState.FAILED:
            self._failed += 1
            self._end(number, OptunaState.FAIL)
        elif standing.state is TrialState.STOPPED:
            self._end(number, OptunaState.PRUNED)
        elif standing.state is TrialState.DONE:
            self._report(number, standing)
            self._done += 1
            self._end(number, OptunaState.COMPLETE, self._values(standing))
        elif self._report(number, standing):
            self._end(number, OptunaState.PRUNED)
            return True
        return False

    def _report(self, number: int, standing: Standing) -> bool:
        """Report new checkpoints; whether the study would prune the trial before its last epoch."""
        if self.asked.pruner is None:
            return False
        known = self._all()[number]
        if known.state.is_finished():  # somebody else has told it
            return False
        trial = optuna.trial.Trial(self.study, known._trial_id)
        is_running = standing.state is TrialState.RUNNING
        for epoch in sorted(set(standing.curve) - self._heard[number]):
            self._heard[number].add(epoch)
            trial.report(standing.curve[epoch][self.objectives[0]], epoch)
            if is_running and epoch < standing.epochs and trial.should_prune():
                return True
        return False

    def _values(self, standing: Standing) -> list[float]:
        curve = standing.curve
        best = max(curve, key=lambda epoch: (curve[epoch][self.objectives[0]], -epoch))
        chosen = curve[max(curve) if self.asked.rule == "last" else best]
        return [chosen[name] for name in self.objectives]

    def _end(self, number: int, state: OptunaState, values: Sequence[float] | None = None) -> None:
        key = self._trials.pop(number)
        self._known[key] = self._tell(number, state, values)

    def _tell(
        self, number: int, state: OptunaState, values: Sequence[float] | None = None
    ) -> FrozenTrial:
        """Tell what became of a trial; one that somebody else has told stays as it is."""
        if not self._all()[number].state.is_finished():
            told = values if state is OptunaState.COMPLETE else None
            try:
                self.study.tell(number, told, state=state)
            except (RuntimeError, KeyError) as error:
                # Samplers end ``Study.optimize`` after their last point, by an error where that does not run; and of a
                # trial that was enqueued GridSampler looks for an entry that it does not have. The trial is told.
                if not self._all()[number].state.is_finished():
                    raise
                self._is_stopped = self._is_stopped or isinstance(error, RuntimeError)
        return self._all()[number]

    def report(self, standings: Mapping[str, Standing], folder: Path) -> str:
        """Best trials, or the Pareto front; all trials go to a table in the folder."""
        name = self.settings.sweep.name
        text = report_study(self.study, self.objectives, list(self.space.axes), name, folder)
        n_points = self.samplers.n_points
        if n_points is not None and n_points < self.n_trials and self._is_exhausted():
            text += f"\nAll {n_points} points were asked for; there are no more for n_trials={self.n_trials}.\n"
        return text


def _counts(trial: FrozenTrial) -> bool:
    """Whether a trial is one of those that were asked for."""
    return trial.state not in (OptunaState.FAIL, OptunaState.WAITING)


def _count(number: int) -> str:
    return f"{number} trial{'' if number == 1 else 's'}"


def _suggest(trial: optuna.Trial, key: str, axis: BaseDistribution) -> None:
    if isinstance(axis, CategoricalDistribution):
        trial.suggest_categorical(key, axis.choices)
    elif isinstance(axis, IntDistribution):
        trial.suggest_int(key, axis.low, axis.high, step=axis.step, log=axis.log)
    elif isinstance(axis, FloatDistribution):
        trial.suggest_float(key, axis.low, axis.high, step=axis.step, log=axis.log)


def study(
    params: Mapping[str, object], arguments: Sequence[str], compose: Compose, settings: Config
) -> Study:
    """The study of a sweep file and the command line.

    Args:
        params: see ``space.parse_space``.
        arguments: see ``space.parse_space``.
        compose: makes a config of overrides.
        settings: further arguments of ``Study``.
    """
    space = parse_space(params, arguments)
    own = {field.name for field in fields(StudySettings)}
    unknown = sorted(set(settings) - own)
    if unknown:
        raise ConfigError(
            f"hydra.sweeper.{unknown[0]}: a study has no such key. {options(unknown[0], sorted(own))} "
            "(A sweep file that names its own sweeper cannot be run by another: hydra/sweeper=... belongs to a grid)"
        )
    return Study(compose(space.fixed), space, compose, **settings)
