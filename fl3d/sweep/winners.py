"""Greedy sweeps: one goes on from the values that won the sweep before it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd

from fl3d.config import Multirun, compose_config
from fl3d.errors import ConfigError, StoreError, options
from fl3d.records import Config
from fl3d.reports.selection import select
from fl3d.results import names, scores_of

PLACES = ("data", "profile", "store", "results")  # what tells where an earlier sweep lies


def with_winners(multirun: Multirun, say: Callable[[str], None] = print) -> Multirun:
    """A sweep that keeps, in front of its own overrides, those that won the sweeps it goes on from.

    Args:
        multirun: the sweep.
        say: prints a line for the user.

    Raises:
        ConfigError: a sweep that names no rule for its winner, or goes on from itself.
        StoreError: a sweep that it goes on from was not run to its end here.
    """
    kept: list[str] = []
    config = multirun.base
    seen, own = [config["sweep"]["name"]], set(multirun.sweeper.get("params", {}))
    while (before := config["sweep"]["after"]) is not None:
        if before in seen:
            raise ConfigError(f"sweep.after: {' goes on from '.join([*seen, before])}: there is no first one")
        seen.append(before)
        places = [a for a in multirun.arguments if a.lstrip("+").partition("=")[0].partition(".")[0] in PLACES]
        config = compose_config([*places, f"+sweep={before}"])
        won, value = winner(config, say)
        won = [override for override in won if override.partition("=")[0] not in own]  # what is swept now is open
        say(f"Keeps {' '.join(won) or 'nothing'}, which won {before} ({config['sweep']['winner']} {value:.4g}).")
        kept = [*won, *kept]
    return replace(multirun, arguments=[*kept, *multirun.arguments])


def winner(config: Config, say: Callable[[str], None] = print) -> tuple[list[str], float]:
    """The overrides of a sweep's best trial by its ``sweep.winner``, last checkpoints, seeds averaged; and the value.

    Args:
        config: of the sweep.
        say: tells where the scores come from, if not from the store.

    Raises:
        ConfigError: the sweep names no such metric.
        StoreError: the sweep was not run to its end here.
    """
    sweep, called = config["sweep"], names(config)
    if sweep["winner"] is None:
        raise ConfigError(f"sweep {sweep['name']}: sweep.winner is not set, so that none can go on from it")
    try:
        scores = scores_of(config, say)
    except StoreError as error:
        raise StoreError(f"a sweep goes on from the winner of {called.experiment}; run that first ({error})") from None
    metrics = [str(column) for column in scores if "/" in str(column)]
    if sweep["winner"] not in metrics:
        raise ConfigError(f"sweep.winner: no metric {sweep['winner']}. {options(sweep['winner'], metrics)}")
    planned = _planned(config)
    missing = planned - set(scores["trial"])
    if missing:
        done = f"{len(planned) - len(missing)} of {len(planned)} trials of {called.experiment} are done"
        raise StoreError(f"{done}; a sweep goes on from its winner, so run it to its end first")
    return best_overrides(scores, sweep["winner"])


def best_overrides(scores: pd.DataFrame, metric: str) -> tuple[list[str], float]:
    """Overrides of the trials of highest metric at their last checkpoint, without the seed, and its mean over seeds."""
    groups: dict[tuple[str, ...], list[float]] = {}
    for overrides, value in select(scores, "last")[["overrides", metric]].itertuples(index=False):
        told = str(overrides).split() if isinstance(overrides, str) else []
        groups.setdefault(tuple(o for o in told if not o.startswith("seed=")), []).append(float(value))
    means = {key: sum(values) / len(values) for key, values in sorted(groups.items())}
    best, value = max(means.items(), key=lambda item: item[1])
    return list(best), value


def _planned(config: Config) -> set[str]:
    """Keys of a sweep's trials, where its plan is at hand."""
    plan = names(config).plan(Path(config["store"]["root"]))
    return {str(trial["key"]) for trial in json.loads(plan.read_text())["trials"]} if plan.exists() else set()
