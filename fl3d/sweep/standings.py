"""How the trials of a plan stand. All that is known of the disk comes as arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from fl3d.core.records import Stage, Trial
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import Outcome
from fl3d.sweep.sweepers.base import Standing, TrialState

Curve = Mapping[int, Mapping[str, float]]
NO_CURVE: Curve = {}


def no_curve(stage: Stage) -> Curve:
    """For sweepers that do not listen: nothing is read."""
    return NO_CURVE


class Standings(Mapping[str, Standing]):
    """How each trial stands, by its key; only those are looked at again of whose stages something has become.

    Args:
        curve: metrics of a stage's checkpoints so far, by its own epochs.
    """

    def __init__(self, curve: Callable[[Stage], Curve] = no_curve) -> None:
        self._curve = curve
        self._plan: Plan | None = None
        self._found: dict[str, Standing] = {}
        self._sharing: dict[
            str, list[Trial]
        ] = {}  # by the stages that they go through before their last

    def __getitem__(self, key: str) -> Standing:
        return self._found[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def update(self, plan: Plan, outcome: Outcome, news: Iterable[str]) -> dict[str, Standing]:
        """Look at the trials that are new, and at those of some stages again; how these stand now.

        Args:
            plan: of the sweep, as it has grown.
            outcome: what has become of its stages.
            news: stages that have ended, or have another checkpoint.
        """
        changed = {trial.key: trial for trial in self._grow(plan)}
        for key in news:
            changed |= {trial.key: trial for trial in self._sharing.get(key, ())}
            if key in self._found:
                changed[key] = self._found[key].trial
        lost = {*outcome.failed, *outcome.blocked}
        found = {
            key: self._stand(plan.stages[key], trial, outcome, lost)
            for key, trial in changed.items()
        }
        self._found |= found
        return found

    def _grow(self, plan: Plan) -> list[Trial]:
        """Trials that the plan has gained."""
        if plan is self._plan:
            return []
        self._plan = plan
        new = [trial for trial in plan.trials if trial.key not in self._found]
        for trial in new:
            for key in trial.stages[:-1]:
                self._sharing.setdefault(key, []).append(trial)
        return new

    def _stand(self, stage: Stage, trial: Trial, outcome: Outcome, lost: set[str]) -> Standing:
        state = _state(trial, outcome, lost)
        return Standing(trial=trial, state=state, curve=self._curve(stage), epochs=stage.epochs)


def _state(trial: Trial, outcome: Outcome, lost: set[str]) -> TrialState:
    if not lost.isdisjoint(trial.stages):
        return TrialState.FAILED
    if trial.key in outcome.stopped:
        return TrialState.STOPPED
    return TrialState.DONE if trial.key in outcome.done else TrialState.RUNNING
