"""Of a finished sweep the trials that words ask for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fl3d.core.digests import digest
from fl3d.core.errors import StoreError, options
from fl3d.runs.design import SEED, in_order, label_of, short_names
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial

Asked = Mapping[str, Sequence[Any]]  # values by key
LONGEST_PART = 120  # bytes of a folder's name


def asked_for(sweep: FinishedSweep, asked: Asked) -> FinishedSweep:
    """The sweep's trials with the values that were asked for, and the baseline beside other levels.

    Which levels are looked at says nothing about how many were compared: ``family`` has all of them. Results of some
    trials alone, or of another baseline, lie apart from those of the whole.

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
    labels = {key: frozenset(label_of(value) for value in asked[key]) for key in told}
    outside = {key: labels[key] for key in told if key not in sweep.factor}
    family = _some(sweep, sweep.trials, outside)
    baseline = [trial for trial in family.trials if trial.level == sweep.baseline]
    found = _some(sweep, (*chosen, *baseline), {}, labels)
    is_narrow = len(found.trials) < len(family.trials)
    found = replace(found, family=family if is_narrow else None)
    return apart(found, _picked(found))


def apart(sweep: FinishedSweep, words: Sequence[str]) -> FinishedSweep:
    """The same, whose results lie in a folder of their own beside those of the sweep as it was run.

    Args:
        sweep: the sweep.
        words: in what it differs; none: in nothing.
    """
    if not words:
        return sweep
    before = sweep.settings.part or sweep.settings.sweep.name
    part = re.sub(r"[^\w.=,+-]+", "-", "_".join([before, *words]))
    if len(part.encode()) > LONGEST_PART:
        part = f"{part.encode()[:LONGEST_PART].decode(errors='ignore')}-{digest(part)[:8]}"
    return replace(sweep, settings=replace(sweep.settings, part=part))


def _some(
    sweep: FinishedSweep,
    trials: Sequence[FinishedTrial],
    wanted: Mapping[str, frozenset[str]],
    labels: Mapping[str, frozenset[str]] | None = None,
) -> FinishedSweep:
    """The sweep of those of some trials that have one of the wanted values of each key.

    Args:
        sweep: the sweep.
        trials: of it.
        wanted: labels of values by key.
        labels: what was asked for; None: what is wanted.
    """
    keys = {
        trial.key
        for trial in trials
        if all(label_of(trial.plan.swept(key)) in values for key, values in wanted.items())
    }
    return replace(
        sweep,
        trials=tuple(trial for trial in sweep.trials if trial.key in keys),
        scores=sweep.scores[sweep.scores["trial"].isin(keys)].reset_index(drop=True),
        asked=wanted if labels is None else labels,
    )


def _picked(sweep: FinishedSweep) -> list[str]:
    """Words that leave planned trials out, or take another baseline; none: all of it was asked for."""
    planned = sweep.plan.trials
    names = short_names(sweep.asked)
    words = []
    for key, labels in sorted(sweep.asked.items()):
        every = in_order(label_of(trial.swept(key)) for trial in planned)
        held = [one for one in planned if one.level != sweep.baseline or key not in sweep.factor]
        if any(label_of(trial.swept(key)) not in labels for trial in held):
            words.append(f"{names[key]}={','.join(one for one in every if one in labels)}")
    if sweep.baseline != sweep.plan.baseline:
        words.append(f"baseline={sweep.baseline}")
    return words


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
