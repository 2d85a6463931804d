"""How the trials of a plan stand. Pure: all that is known of the disk comes as arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fl3d.core.records import Stage, Trial
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import Outcome
from fl3d.sweep.sweepers.base import Standing, TrialState

Curve = Mapping[int, Mapping[str, float]]


def no_curve(stage: Stage) -> Curve:
    """For sweepers that do not listen: nothing is read."""
    return {}


def stand(plan: Plan, outcome: Outcome, curve: Callable[[Stage], Curve]) -> dict[str, Standing]:
    """How each trial stands, by its key.

    Args:
        plan: of the sweep.
        outcome: what has become of its stages.
        curve: metrics of a stage's checkpoints so far, by its own epochs.
    """
    ended = outcome.done
    return {
        trial.key: Standing(
            trial=trial,
            state=_state(trial, outcome, ended),
            curve=curve(plan.stages[trial.key]),
            epochs=plan.stages[trial.key].epochs,
        )
        for trial in plan.trials
    }


def _state(trial: Trial, outcome: Outcome, done: set[str]) -> TrialState:
    if any(key in outcome.failed or key in outcome.blocked for key in trial.stages):
        return TrialState.FAILED
    if trial.key in outcome.stopped:
        return TrialState.STOPPED
    return TrialState.DONE if trial.key in done else TrialState.RUNNING
