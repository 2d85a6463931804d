"""Tells a study how its trials in training do, and what became of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from optuna.trial import FrozenTrial
from optuna.trial import TrialState as OptunaState

from fl3d.sweep.sweepers.base import Standing, TrialState
from fl3d.sweep.sweepers.study_settings import StudySettings
from fl3d.sweep.sweepers.study_trials import Trials


class Teller:
    """Tells a study of this start's trials.

    Args:
        trials: of the study.
        asked: whose value counts, and whether trials are pruned.
        known: trials that earlier starts have told, by key.

    Attributes:
        known: and those of this start.
        expected: trials of this start that are not told: the study's number, and our key.
        failed: how many of this start have.
        done: how many of this start are.
    """

    def __init__(
        self, trials: Trials, asked: StudySettings, known: Mapping[str, FrozenTrial]
    ) -> None:
        self.trials = trials
        self.asked = asked
        self.known = dict(known)
        self.expected: dict[int, str] = {}
        self.failed = 0
        self.done = 0
        self._heard: dict[int, set[int]] = {}  # epochs that were reported

    def expect(self, number: int, key: str) -> None:
        """Listen for a trial from now on."""
        self.expected[number] = key
        self._heard[number] = set()

    def hear(self, standings: Mapping[str, Standing]) -> list[str]:
        """Report and tell all that is news; keys of trials that shall be stopped."""
        return [
            key for number, key in list(self.expected.items()) if self._hear(number, standings[key])
        ]

    def _hear(self, number: int, standing: Standing) -> bool:
        """Report and tell a trial; whether it shall be stopped."""
        if standing.state is TrialState.FAILED:
            self.failed += 1
            self._end(number, OptunaState.FAIL)
        elif standing.state is TrialState.STOPPED:
            self._end(number, OptunaState.PRUNED)
        elif standing.state is TrialState.DONE:
            self._report(number, standing)
            self.done += 1
            self._end(number, OptunaState.COMPLETE, self._values(standing))
        elif self._report(number, standing):
            self._end(number, OptunaState.PRUNED)
            return True
        return False

    def _report(self, number: int, standing: Standing) -> bool:
        """Report new checkpoints; whether the study would prune the trial before its last epoch."""
        if self.asked.pruner is None:
            return False
        known = self.trials.all()[number]
        if known.state.is_finished():  # somebody else has told it
            return False
        trial = self.trials.opened(known)
        is_running = standing.state is TrialState.RUNNING
        for epoch in sorted(set(standing.curve) - self._heard[number]):
            self._heard[number].add(epoch)
            trial.report(standing.curve[epoch][self.asked.objectives[0]], epoch)
            if is_running and epoch < standing.epochs and trial.should_prune():
                return True
        return False

    def _values(self, standing: Standing) -> list[float]:
        curve, objectives = standing.curve, self.asked.objectives
        best = max(curve, key=lambda epoch: (curve[epoch][objectives[0]], -epoch))
        chosen = curve[max(curve) if self.asked.rule == "last" else best]
        return [chosen[name] for name in objectives]

    def _end(self, number: int, state: OptunaState, values: Sequence[float] | None = None) -> None:
        key = self.expected.pop(number)
        self.known[key] = self.trials.tell(number, state, values)
