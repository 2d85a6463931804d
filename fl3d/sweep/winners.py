"""Greedy sweeps: one goes on from the values that won the sweep before it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from fl3d.config import Multirun, compose_config
from fl3d.errors import ConfigError, StoreError, options
from fl3d.records import Config
from fl3d.reports.selection import select
from fl3d.results import names, scores_of


def with_winners(multirun: Multirun) -> Multirun:
    """A sweep that keeps, in front of its own overrides, those that won the sweeps it goes on from.

    Raises:
        ConfigError: a sweep that names no rule for its winner, or goes on from itself.
        StoreError: a sweep that it goes on from was not run here.
    """
    kept: list[str] = []
    config = multirun.base
    seen = [config["sweep"]["name"]]
    while (before := config["sweep"]["after"]) is not None:
        if before in seen:
            raise ConfigError(f"sweep.after: {' goes on from '.join([*seen, before])}: there is no first one")
        seen.append(before)
        config = compose_config([*_shared(multirun.arguments), f"+sweep={before}"])
        kept = [*winner(config), *kept]
    return replace(multirun, arguments=[*kept, *multirun.arguments])


def _shared(arguments: Sequence[str]) -> list[str]:
    """What all sweeps of a chain are given alike: where data and store are, and the profile."""
    fixed = ("data", "profile", "store", "results", "protocol", "seed", "schedule")
    return [a for a in arguments if a.lstrip("+").partition("=")[0].partition(".")[0] in fixed]


def winner(config: Config) -> list[str]:
    """The overrides of a sweep's best trial by its ``sweep.winner``, seeds averaged, last checkpoints.

    Raises:
        ConfigError: the sweep names no such metric.
        StoreError: the sweep was not run here.
    """
    sweep, called = config["sweep"], names(config)
    if sweep["winner"] is None:
        raise ConfigError(f"sweep {sweep['name']}: sweep.winner is not set, so that none can go on from it")
    try:
        scores = scores_of(config)
    except StoreError as error:
        raise StoreError(f"a sweep goes on from the winner of {called.experiment}; run that first ({error})") from None
    metrics = [str(column) for column in scores if "/" in str(column)]
    if sweep["winner"] not in metrics:
        raise ConfigError(f"sweep.winner: no metric {sweep['winner']}. {options(sweep['winner'], metrics)}")
    best = best_overrides(scores, sweep["winner"], _overrides(config))
    return [override for override in best if not override.startswith("seed=")]


def best_overrides(scores: pd.DataFrame, metric: str, overrides: dict[str, list[str]]) -> list[str]:
    """Overrides of the trials of highest metric at their last checkpoint; of equal ones the first in the plan."""
    last = select(scores, "last").set_index("trial")[metric]
    groups: dict[tuple[str, ...], list[float]] = {}
    for trial, own in overrides.items():
        if trial in last.index:
            key = tuple(override for override in own if not override.startswith("seed="))
            groups.setdefault(key, []).append(float(last[trial]))
    return list(max(groups.items(), key=lambda item: sum(item[1]) / len(item[1]))[0])


def _overrides(config: Config) -> dict[str, list[str]]:
    """Of each trial, in the plan's order."""
    plan = json.loads(names(config).plan(Path(config["store"]["root"])).read_text())
    return {trial["key"]: trial["overrides"] for trial in plan["trials"]}
