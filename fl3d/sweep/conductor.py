"""Between sweeper, scheduler and recorder: what is trained goes to the store, and to a sweeper that listens."""

from __future__ import annotations

from collections.abc import Callable

from fl3d.leases import holder_of
from fl3d.records import Stage, StagePaths, Trial
from fl3d.sweep.planner import Planner
from fl3d.sweep.progress import Progress
from fl3d.sweep.recorder import Recorder
from fl3d.sweep.retention import superfluous_weights
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.sweepers.base import Standing, Sweeper, TrialState

STATUS = {TrialState.FAILED: "FAILED", TrialState.STOPPED: "KILLED"}  # what MLflow calls it


class Conductor:
    """Runs a sweep's stages, and lets the sweeper add and stop trials.

    Args:
        sweeper: proposes.
        planner: lays out what it proposes.
        scheduler: trains; holds the plan.
        recorder: writes to the store.
        scores: of the checkpoints.
        progress: shown to the user.
        grown: called whenever the scheduler's plan has grown.
        keep_every: see ``retention.kept_epochs``.
        check: makes sure that this process still leads the sweep.
    """

    def __init__(
        self,
        sweeper: Sweeper,
        planner: Planner,
        scheduler: Scheduler,
        recorder: Recorder,
        scores: Scoreboard,
        progress: Progress,
        grown: Callable[[], None],
        keep_every: int | None,
        check: Callable[[], None],
    ) -> None:
        self.sweeper, self.planner, self.scheduler = sweeper, planner, scheduler
        self.recorder, self.scores, self.progress, self.grown = recorder, scores, progress, grown
        self.keep_every, self.check = keep_every, check
        self._told: set[str] = set()
        self._tidied: set[str] = set()

    def run(self) -> Outcome:
        """Train to the end; the store holds all when this returns."""
        self.scheduler.on_tick = self._tick
        self.scheduler.on_failure = lambda stage, trace: self.progress.say(f"\n{stage.key} failed:\n{trace}")
        outcome = self.scheduler.run()
        self.recorder.finish(self.scheduler.plan, self._ended())
        self._tidy()
        return outcome

    def standings(self) -> dict[str, Standing]:
        """How all trials stand, with the scores that are on disk."""
        plan = self.scheduler.plan
        return {
            trial.key: Standing(
                trial, self._state(trial), self.scores.curve(plan.stages[trial.key]), plan.stages[trial.key].epochs
            )
            for trial in plan.trials
        }

    def _tick(self, running: list[Stage]) -> None:
        self.check()
        self._say_who_trains_elsewhere()
        if self.recorder.sync(self.scheduler.plan, self._ended()):
            self._tidy()
        if self.sweeper.listens:
            self._advise()
        self.progress.tick(running)

    def _say_who_trains_elsewhere(self) -> None:
        for key in self.scheduler.elsewhere - self._told:
            self._told.add(key)
            self.progress.say(f"{key} is in training by {holder_of(self.scores.paths(key).lease)}; waiting for it")

    def _tidy(self) -> None:
        """Drop superfluous weights of stages that are done, once the store has its models."""
        for key, stage in self.scheduler.plan.stages.items():
            if key not in self._tidied and self.scores.paths(key).done.exists():
                self._tidied.add(key)
                for path in superfluous_weights(self.scores.paths(key), stage, self.keep_every):
                    path.unlink(missing_ok=True)

    def _advise(self) -> None:
        advice = self.sweeper.advise(self.standings(), self.scheduler.launcher.slots)
        if advice.points:
            self.scheduler.plan = self.scheduler.plan.joined(self.planner.plan(advice.points))
            self.progress.plan = self.scheduler.plan
            self.grown()
        for key in advice.stop:
            self.scheduler.stop(key)
            self.progress.stopped.add(key)

    def _ended(self) -> dict[str, str]:
        states = {trial.key: self._state(trial) for trial in self.scheduler.plan.trials}
        return {key: STATUS[state] for key, state in states.items() if state in STATUS}

    def _state(self, trial: Trial) -> TrialState:
        outcome = self.scheduler.outcome
        if {*outcome.failed, *outcome.blocked} & set(trial.stages):
            return TrialState.FAILED
        if trial.key in outcome.stopped:
            return TrialState.STOPPED
        done = StagePaths(self.scheduler.stages_root / trial.key).done.exists()
        return TrialState.DONE if done else TrialState.GOING
