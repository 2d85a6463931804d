"""Score stored detections of a sweep again, under other protocols: no network is run."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import pandas as pd
from tqdm import tqdm

from fl3d.core.errors import ConfigError, options
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.results import APPLIES
from fl3d.evaluation.scoring import score
from fl3d.runs.design import label_of
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import is_of_program
from fl3d.runs.scores import scores_of_class

NO_KEYS = ("name", "overlaps", "neighbours", "classes")
KEYS = tuple(field.name for field in fields(Protocol) if field.name not in NO_KEYS)


def rescore(sweep: FinishedSweep, changes: Mapping[str, Sequence[Any]]) -> pd.DataFrame:
    """Scores of the last models of a sweep under every combination of changed protocol values.

    Args:
        sweep: its run folders must be at hand.
        changes: values of protocol keys, such as ``{"score_threshold": [0, 0.8]}``.

    Returns:
        a row a trial and combination: group, level, seed, step, protocol, the changed keys (as text), every AP.

    Raises:
        ConfigError: a key that no protocol has, or that means nothing to result files of a program, or a value that it
            does not take.
        StoreError: only its scores are here.
    """
    for key in changes:
        if key not in KEYS:
            raise ConfigError(f"{key}: no key of a protocol. {options(key, KEYS)}")
    if any(is_of_program(trial.plan) for trial in sweep.trials):
        for key in sorted(set(changes) - set(APPLIES)):
            raise ConfigError(
                f"{key}: the sweep's detections are result files that its program has suppressed itself, so that this "
                f"changes nothing of them. {options(key, APPLIES)}"
            )
    combinations = [
        dict(zip(changes, values, strict=True)) for values in itertools.product(*changes.values())
    ]
    protocols = [replace(sweep.protocol, **combination) for combination in combinations]
    rows = []
    pairs = list(itertools.product(sweep.trials, zip(combinations, protocols, strict=True)))
    for trial, (combination, protocol) in tqdm(pairs, unit="score", disable=None):
        front = {
            "group": trial.group,
            "level": trial.level,
            "seed": trial.seed,
            "step": trial.last_step,
        }
        changed = {name: label_of(value) for name, value in combination.items()}
        scores = score(sweep.detections(trial), sweep.validation, protocol)
        rows.append({**front, "protocol": protocol.id, **changed, **scores})
    place = {level: number for number, level in enumerate(sweep.levels)}
    frame = pd.DataFrame(rows)
    if sweep.class_name is not None:
        frame = scores_of_class(frame, sweep.class_name)
    order = frame.assign(place=frame["level"].map(place)).sort_values(
        ["group", "place", "seed"], kind="stable"
    )
    return order.drop(columns="place").reset_index(drop=True)
