"""Trials by Optuna's ask and tell: same plan and launchers as a grid, pruned by checkpoints."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import optuna
from optuna.trial import FrozenTrial
from optuna.trial import TrialState as OptunaState

from fl3d.config.objects import build
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError, options
from fl3d.core.names import check_name
from fl3d.core.records import Config
from fl3d.evaluation.selection import RULES
from fl3d.store.opening import open_store
from fl3d.sweep.sweepers.base import Advice, Compose, Point, Standing, Sweeper, TrialState
from fl3d.sweep.sweepers.grid import point_of
from fl3d.sweep.sweepers.space import Space, parse_space
from fl3d.sweep.sweepers.study_report import KEY, report_study
from fl3d.sweep.sweepers.study_storage import experimental, open_storage

# Attributes of a trial in the study, beside ``KEY``.
ROOT = "fl3d.store"  # where it was trained
SOURCE = "fl3d.value_of"  # the trial whose value it was told
MAX_FAILED = 3  # trials that fail before any is done: then something is wrong with all of them


class Study(Sweeper):
    """Asks an Optuna study for trials, as many at once as there are slots, and tells it their AP.

    A point that was proposed before is not trained again: it is told the same value. A trial that
    a dead sweep left running is told as failed, and its point is asked for again: its stages resume
    from their checkpoints.

    Args:
        base: a config of the sweep.
        space: what is searched.
        compose: makes a config of overrides.
        n_trials: how many are asked for, over all starts of this sweep.
        objectives: metrics to maximise, such as ``ap_3d_r40/moderate``; several make a Pareto
            front.
        rule: whose value counts: of the ``last`` or the ``best`` checkpoint.
        sampler: section with the ``_target_`` of an Optuna sampler, whose seed is varied when a
            study is resumed; None: TPE.
        pruner: section of an Optuna pruner, or None; for one objective, on each checkpoint of a
            trial's last stage.
        storage: URL of a database for the study; None: a journal file below the store's root.
        study_name: None: the sweep's.
        enqueue: points to ask first, such as the baseline: ``[{loss.gamma: 0}]``.

    Raises:
        ConfigError: settings that do not go together.
    """

    listens = True

    def __init__(
        self,
        base: Config,
        space: Space,
        compose: Compose,
        n_trials: int = 20,
        objectives: Sequence[str] = ("ap_3d_r40/moderate",),
        rule: str = "last",
        sampler: Config | None = None,
        pruner: Config | None = None,
        storage: str | None = None,
        study_name: str | None = None,
        enqueue: Sequence[Config] = (),
    ) -> None:
        self.base = base
        self.settings = read_settings(base)
        self.space = space
        self.swept = tuple(key.lstrip("+") for key in space.axes)
        self.compose = compose
        self.n_trials = n_trials
        self.objectives = list(objectives)
        self.rule = rule
        self.pruner = pruner
        self.sampler = sampler or {"_target_": "optuna.samplers.TPESampler", "seed": base["seed"]}
        self.storage = storage
        if study_name is not None and storage is None:  # then a file has it
            check_name("hydra.sweeper.study_name", study_name)
        self.name = study_name or self.settings.experiment
        self.enqueue = enqueue
        self._trials: dict[int, str] = {}  # of this start: the study's number, and our key
        self._heard: dict[int, set[int]] = {}
        self._known: dict[str, FrozenTrial] = {}  # told, by key
        self._earlier: list[Point] = []
        self._pruned: list[str] = []
        self._failed = 0
        self._done = 0
        self._check_settings()

    def _check_settings(self) -> None:
        """Refuse settings that do not go together."""
        if self.rule not in RULES:
            raise ConfigError(f"hydra.sweeper.rule: {options(self.rule, RULES)}")
        for name in self.objectives or [""]:
            if name not in self.settings.protocol.metric_names:
                possible = options(name, self.settings.protocol.metric_names)
                raise ConfigError(f"hydra.sweeper.objectives: no metric '{name}'. {possible}")
        if self.pruner is not None and len(self.objectives) > 1:
            raise ConfigError(
                "hydra.sweeper.pruner: Optuna prunes on one objective only; "
                "set pruner=null or one objective"
            )
        if self.settings.sweep.tables:
            raise ConfigError(
                "sweep.tables: the papers' tables are made of a grid; "
                "an Optuna sweep has tables of its own"
            )
        axes = self.space.axes
        for point in self.enqueue:
            if set(point) != set(axes):
                raise ConfigError(
                    f"hydra.sweeper.enqueue: {dict(point)} does not name exactly {', '.join(axes)}"
                )

    def first(self) -> Sequence[Point]:
        """None: what comes first depends on the study."""
        return ()

    def open(self, identify: Callable[[Point], str]) -> None:
        """Open the study, and take up what a dead sweep left."""
        self._identify = identify
        store = self.settings.store
        self._root = open_store(store.root, store.uri).id
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.study = self._open()
        if not self._all():
            for point in self.enqueue:
                self.study.enqueue_trial(dict(point))
        trials = [trial for trial in self._all() if trial.user_attrs.get(ROOT) == self._root]
        for trial in trials:
            self._check_axes(trial)
        for trial in trials:
            if trial.state is OptunaState.RUNNING:
                self.study.tell(trial.number, state=OptunaState.FAIL)
                self.study.enqueue_trial(trial.params)
            elif trial.state in (OptunaState.COMPLETE, OptunaState.PRUNED):
                self._take_up(trial)

    def _check_axes(self, trial: FrozenTrial) -> None:
        kinds = {key: type(axis) for key, axis in self.space.axes.items()}
        if kinds != {key: type(axis) for key, axis in trial.distributions.items()}:
            raise ConfigError(
                f"hydra.sweeper.params: the study '{self.name}' was begun with another space "
                f"({', '.join(trial.distributions)}); give another hydra.sweeper.study_name"
            )

    def _all(self) -> list[FrozenTrial]:
        """All trials of the study, whoever asked for them; to be read only."""
        return self.study.get_trials(deepcopy=False)

    def _take_up(self, trial: FrozenTrial) -> None:
        """Propose again what an earlier start has told: not trained, it belongs to the sweep."""
        point = self._point(trial)
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

    def _point(self, trial: FrozenTrial) -> Point:
        overrides = self.space.overrides(trial)
        return point_of(overrides, self.compose([*self.space.fixed, *overrides]))

    def _open(self) -> optuna.Study:
        store = self.settings.store
        storage = open_storage(self.storage, store.root, store.uri, name=self.name)
        directions = [optuna.study.StudyDirection.MAXIMIZE] * len(self.objectives)
        with experimental():
            study = optuna.create_study(
                storage=storage,
                study_name=self.name,
                directions=directions,
                pruner=self._make_pruner(),
                load_if_exists=True,
            )
            self._check_attributes(study)
            study.sampler = self._make_sampler(len(study.get_trials(deepcopy=False)))
        return study

    def _make_pruner(self) -> optuna.pruners.BasePruner:
        if not self.pruner:
            return optuna.pruners.NopPruner()
        pruner: optuna.pruners.BasePruner = build(self.pruner, "hydra.sweeper.pruner")
        return pruner

    def _make_sampler(self, n_asked: int) -> optuna.samplers.BaseSampler:
        # The same seed again would propose the first trials again.
        seed = self.sampler.get("seed")
        varied = {} if seed is None else {"seed": seed + n_asked}
        sampler: optuna.samplers.BaseSampler = build(
            {**self.sampler, **varied}, "hydra.sweeper.sampler"
        )
        return sampler

    def _check_attributes(self, study: optuna.Study) -> None:
        """Refuse a study whose values mean something else; a new one remembers what its mean."""
        attributes = {
            "objectives": self.objectives,
            "rule": self.rule,
            "protocol": self.settings.protocol.id,
        }
        for key, value in attributes.items():
            before = study.user_attrs.get(key, value)
            if before != value:
                raise ConfigError(
                    f"{key}: the study '{self.name}' was begun with {before}, not {value}; their "
                    "values cannot be compared; give another hydra.sweeper.study_name"
                )
            study.set_user_attr(key, value)

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        """Tell what has ended, prune, and ask for as many trials as there are free slots."""
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
        uncounted = (OptunaState.FAIL, OptunaState.WAITING)
        asked = sum(trial.state not in uncounted for trial in self._all())
        return asked + self._failed < self.n_trials

    def _ask(self, standings: Mapping[str, Standing]) -> Point | None:
        """A point to train, or None where its trial is known."""
        trial = self.study.ask(dict(self.space.axes))
        point = self._point(self._all()[trial.number])
        try:
            key = self._identify(point)
        except ConfigError:
            self.study.tell(trial.number, state=OptunaState.FAIL)
            raise
        trial.set_user_attr(KEY, key)
        trial.set_user_attr(ROOT, self._root)
        twin = self._known.get(key)
        if twin is not None and twin.state is not OptunaState.FAIL:
            trial.set_user_attr(SOURCE, twin.number)
            self._tell(trial.number, twin.state, twin.values)
            return None
        self._trials[trial.number] = key
        self._heard[trial.number] = set()
        return None if key in standings else point

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
        if self.pruner is None:
            return False
        trial = optuna.trial.Trial(self.study, self._all()[number]._trial_id)
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
        chosen = curve[max(curve) if self.rule == "last" else best]
        return [chosen[name] for name in self.objectives]

    def _end(self, number: int, state: OptunaState, values: Sequence[float] | None = None) -> None:
        key = self._trials.pop(number)
        self._known[key] = self._tell(number, state, values)

    def _tell(
        self, number: int, state: OptunaState, values: Sequence[float] | None = None
    ) -> FrozenTrial:
        if state is OptunaState.COMPLETE and values is not None:
            return self.study.tell(number, values)
        return self.study.tell(number, state=state)

    def report(self, standings: Mapping[str, Standing], folder: Path) -> str:
        """Best trials, or the Pareto front; all trials go to a table in the folder."""
        name = self.settings.sweep.name
        return report_study(self.study, self.objectives, list(self.space.axes), name, folder)


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
    own = set(inspect.signature(Study).parameters) - {"base", "space", "compose"}
    unknown = sorted(set(settings) - own)
    if unknown:
        raise ConfigError(
            f"hydra.sweeper.{unknown[0]}: a study has no such key. {options(unknown[0], sorted(own))} "
            "(A sweep file that names its own sweeper cannot be run by another: hydra/sweeper=... belongs to a grid)"
        )
    return Study(compose(space.fixed), space, compose, **settings)
