"""The trials of an Optuna study, as one sweep reads and writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState, create_trial

# Attributes of a trial, beside ``KEY``. The first two it has before anything else of it is written.
ROOT = "fl3d.store"  # where it is trained
SWEEP = "fl3d.sweep"  # by which sweep: its lease says whether that lives
SOURCE = "fl3d.value_of"  # the trial whose value it was told


class Trials:
    """All trials of a study, whoever asked for them.

    Args:
        study: that is open.
        root: the store's id.
        sweep: the experiment that asks.

    Attributes:
        is_stopped: whether the sampler has ended the study.
    """

    def __init__(self, study: optuna.Study, root: str, sweep: str) -> None:
        self.study = study
        self.name = study.study_name
        self.root = root
        self.sweep = sweep
        self.is_stopped = False

    @property
    def own(self) -> dict[str, Any]:
        """What every trial of this sweep carries."""
        return {ROOT: self.root, SWEEP: self.sweep}

    def all(self) -> list[FrozenTrial]:
        """By their numbers; to be read only."""
        return self.study.get_trials(deepcopy=False)

    def is_ours(self, trial: FrozenTrial) -> bool:
        """Whether a trial is trained in this store, by whichever sweep."""
        return bool(trial.user_attrs.get(ROOT) == self.root)

    def enqueue(self, params: Mapping[str, Any]) -> None:
        """Ask a point before others."""
        self.study.enqueue_trial(dict(params), user_attrs=self.own)

    def next(self) -> optuna.Trial:
        """One that waits, or a new one, which is the sweep's from its first line."""
        if not any(one.state is TrialState.WAITING for one in self.all()):
            self.study.add_trial(create_trial(state=TrialState.WAITING, user_attrs=self.own))
        return self.study.ask()

    def opened(self, trial: FrozenTrial) -> optuna.Trial:
        """A trial that runs, to write to."""
        return optuna.trial.Trial(self.study, trial._trial_id)

    def tell(
        self, number: int, state: TrialState, values: Sequence[float] | None = None
    ) -> FrozenTrial:
        """Tell what became of a trial; one that somebody else has told stays as it is."""
        if not self.all()[number].state.is_finished():
            told = values if state is TrialState.COMPLETE else None
            try:
                self.study.tell(number, told, state=state)
            except (RuntimeError, KeyError) as error:
                # Samplers end ``Study.optimize`` after their last point, by an error where that does not run; and of a
                # trial that was enqueued GridSampler looks for an entry that it does not have. The trial is told.
                if not self.all()[number].state.is_finished():
                    raise
                self.is_stopped = self.is_stopped or isinstance(error, RuntimeError)
        return self.all()[number]


def is_told(trial: FrozenTrial) -> bool:
    """Whether a trial has come to a value, or was pruned."""
    return trial.state in (TrialState.COMPLETE, TrialState.PRUNED)


def counts(trial: FrozenTrial) -> bool:
    """Whether a trial is one of those that were asked for."""
    return trial.state not in (TrialState.FAIL, TrialState.WAITING)
