"""Of a finished sweep the trials that words ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fl3d.core.errors import StoreError, options
from fl3d.runs.design import SEED, label_of
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial

Asked = Mapping[str, Sequence[Any]]  # values by key


def asked_for(sweep: FinishedSweep, asked: Asked) -> FinishedSweep:
    """The sweep's trials with the values that were asked for, and the baseline beside other levels.

    Raises:
        StoreError: none of its trials has one of the values.
    """
    told = [
        key
        for key in asked
        if key == SEED or any(key in trial.plan.values for trial in sweep.trials)
    ]  # the others are not what the sweep's trials differ in
    chosen = sweep.trials
    for key in told:
        chosen = _with_values(sweep, chosen, key, asked[key])
    outside = [key for key in told if key not in sweep.factor]
    baseline = [trial for trial in sweep.trials if trial.level == sweep.baseline]
    for key in outside:
        wanted = {label_of(value) for value in asked[key]}
        baseline = [trial for trial in baseline if label_of(trial.plan.swept(key)) in wanted]
    keys = {trial.key for trial in (*chosen, *baseline)}
    scores = sweep.scores[sweep.scores["trial"].isin(keys)].reset_index(drop=True)
    trials = tuple(trial for trial in sweep.trials if trial.key in keys)
    labels = {key: frozenset(label_of(value) for value in asked[key]) for key in told}
    return replace(sweep, trials=trials, scores=scores, asked=labels)


def _with_values(
    sweep: FinishedSweep, trials: Sequence[FinishedTrial], key: str, values: Sequence[Any]
) -> tuple[FinishedTrial, ...]:
    """Those of some trials that have one of some values.

    Raises:
        StoreError: none of them has one of the values.
    """
    wanted = {label_of(value) for value in values}
    stored = {label_of(trial.plan.swept(key)) for trial in trials}
    for label in sorted(wanted - stored):
        raise StoreError(
            f"{key}={label}: {sweep.settings.experiment} has no finished trial with it. "
            f"{options(label, stored)}"
        )
    return tuple(trial for trial in trials if label_of(trial.plan.swept(key)) in wanted)
