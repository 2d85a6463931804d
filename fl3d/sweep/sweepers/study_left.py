"""What earlier starts and other sweeps have left in a study, taken up by one that starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from optuna.trial import FrozenTrial, TrialState

from fl3d.core.errors import ConfigError
from fl3d.core.leases import living
from fl3d.core.plurals import several
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.sweepers.base import Point
from fl3d.sweep.sweepers.samplers import Samplers
from fl3d.sweep.sweepers.study_points import Points
from fl3d.sweep.sweepers.study_report import KEY
from fl3d.sweep.sweepers.study_trials import ROOT, SWEEP, Trials, is_told


class Left:
    """What was left, as far as it is this sweep's now.

    Args:
        trials: of the study.
        points: their points in the sweep.
        samplers: of the sweep.

    Attributes:
        known: trials that were told, by key.
        earlier: their points: they are not trained, and belong to the sweep.
        pruned: keys of those that were.
        unbegun: trials that died before they had their points.
    """

    def __init__(self, trials: Trials, points: Points, samplers: Samplers) -> None:
        self.trials, self.points, self.samplers = trials, points, samplers
        self.known: dict[str, FrozenTrial] = {}
        self.earlier: list[Point] = []
        self.pruned: list[str] = []
        self.unbegun: list[FrozenTrial] = []

    def take_up(self, layout: StoreFolder, say: Callable[[str], None]) -> None:
        """Propose again what was told, and ask again for what a dead sweep left running.

        Args:
            layout: of the store, with the leases of its sweeps.
            say: told what was found.

        Raises:
            ConfigError: the study was begun with other data, versions or settings.
        """
        ended = self._ended_sweeps(layout)
        trials = list(self.trials.all())  # read now: finding out may have taken a minute
        running = [trial for trial in trials if trial.state is TrialState.RUNNING]
        dead = {trial.number for trial in running if self._is_dead(trial, ended)}
        for trial in trials:
            if trial.number in dead:
                self._begin_again(trial)
            elif self.trials.is_ours(trial) and is_told(trial):
                self._propose_again(trial)
        if self.samplers.is_exhaustive:
            self._ask_failed_again()
        self._say_running(len(dead), len(running) - len(dead), say)

    def hand_over(self) -> tuple[list[Point], list[str]]:
        """The earlier points, and the keys of those that were pruned; once."""
        given = self.earlier, self.pruned
        self.earlier, self.pruned = [], []
        return given

    def _ended_sweeps(self, layout: StoreFolder) -> set[str]:
        """Sweeps of this store that left trials running, and that nobody runs any more."""
        own = self.trials.sweep
        begun = {
            self._sweep_of(trial)
            for trial in self.trials.all()
            if trial.state is TrialState.RUNNING and self.trials.is_ours(trial)
        }
        leases = {sweep: layout.lease(sweep) for sweep in begun - {own}}
        held = living(leases.values())
        # This process holds the lease of its own sweep: nobody else can be training for that.
        return {own, *(sweep for sweep, lease in leases.items() if lease not in held)}

    def _sweep_of(self, trial: FrozenTrial) -> str:
        return str(trial.user_attrs.get(SWEEP, self.trials.sweep))

    def _is_dead(self, trial: FrozenTrial, ended: set[str]) -> bool:
        """Whether nobody trains a trial that the study calls running."""
        # Optuna's own ask, killed before it got its attributes.
        if trial.user_attrs.get(ROOT) is None:
            return True
        return self.trials.is_ours(trial) and self._sweep_of(trial) in ended

    def _begin_again(self, trial: FrozenTrial) -> None:
        """Ask for a dead trial's point again, or give it one."""
        if not self.points.is_whole(trial.params) or self.samplers.is_exhaustive:
            self.unbegun.append(trial)  # a grid would count it as tried if it were told as failed
            return
        if not self.points.outside(trial.params):
            self.trials.enqueue(trial.params)
        self.trials.tell(trial.number, TrialState.FAIL)

    def _propose_again(self, trial: FrozenTrial) -> None:
        """Propose again what an earlier start has told: not trained, it belongs to the sweep."""
        point = self.points.of(trial.params)
        key = self.points.identify(point)
        if key != trial.user_attrs.get(KEY):
            raise ConfigError(
                f"the study '{self.trials.name}' was begun with other data, versions or settings: "
                f"its trial {trial.number} was {trial.user_attrs.get(KEY)}, "
                f"and would be {key} now; give another hydra.sweeper.study_name"
            )
        self.known[key] = trial
        self.earlier.append(point)
        if trial.state is TrialState.PRUNED:
            self.pruned.append(key)

    def _ask_failed_again(self) -> None:
        """A grid is whole when each of its points is done: those that failed are tried again, once a start."""
        failed: dict[tuple[Any, ...], FrozenTrial] = {}
        others: set[tuple[Any, ...]] = set()
        for trial in self.trials.all():
            params = trial.system_attrs.get("fixed_params", trial.params)
            if not self.samplers.holds(params):
                continue
            point = tuple(params[key] for key in self.points.axes)
            if trial.state is TrialState.FAIL:
                failed[point] = trial
            else:
                others.add(point)
        for point, trial in failed.items():
            if point not in others:
                self.trials.enqueue(trial.params)

    def _say_running(self, dead: int, elsewhere: int, say: Callable[[str], None]) -> None:
        name = self.trials.name
        if dead:
            say(
                f"The study '{name}' had {several(dead, 'trial')} that an interrupted start left running: "
                "asked for again."
            )
        if elsewhere:
            say(
                f"In the study '{name}' other sweeps or stores have {several(elsewhere, 'trial')} running, "
                "which count too."
            )
