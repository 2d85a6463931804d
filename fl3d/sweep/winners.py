"""Greedy sweeps: one builds on the values that won the sweep before it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from fl3d.config.compose import Multirun, compose_config
from fl3d.config.places import PUBLISHED
from fl3d.config.settings import Settings, read_settings
from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, StoreError, options
from fl3d.runs.design import SEED
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import open_sweep
from fl3d.runs.plans import FrozenTrial
from fl3d.sweep.sweepers.params import check_params

PLACES = ("data", "profile", "store", "results")  # what tells where an earlier sweep lies


@dataclass(frozen=True)
class Winner:
    """What won a sweep.

    Args:
        overrides: of its best trial, as the user wrote them, by key; without the seed.
        value: of the metric that decides, averaged over seeds.
    """

    overrides: Mapping[str, str]
    value: float


def with_winners(multirun: Multirun, say: Callable[[str], None] = print) -> Multirun:
    """A sweep that keeps, in front of its own overrides, those that won the sweeps it builds on.

    Args:
        multirun: the sweep.
        say: prints a line for the user.

    Raises:
        ConfigError: a sweep that names no rule for its winner, or builds on itself, or swept values that are none.
        StoreError: a sweep that it builds on was not run to its end here.
    """
    sweep = read_settings(multirun.base).sweep
    check_params(multirun.sweeper.get("params", {}))
    is_open = {key.lstrip("+") for key in multirun.sweeper.get("params", {})}  # swept now
    seen = [sweep.name]
    kept: dict[str, str] = {}
    while sweep.after is not None:
        if sweep.after in seen:
            chain = " builds on ".join([*seen, sweep.after])
            raise ConfigError(f"sweep.after: {chain}: there is no first one")
        seen.append(sweep.after)
        settings = _settings_of(sweep.after, multirun.arguments)
        sweep = settings.sweep
        won = winner(settings, say)
        own = {key: text for key, text in won.overrides.items() if key not in is_open}
        words = " ".join(own.values()) or "nothing"
        say(f"Keeps {words}, which won {sweep.name} ({sweep.winner} {won.value:.4g}).")
        kept = {**own, **kept}
    return replace(multirun, arguments=[*kept.values(), *multirun.arguments])


def winner(settings: Settings, say: Callable[[str], None] = print) -> Winner:
    """A sweep's best trial by its ``sweep.winner``: last checkpoints, seeds averaged.

    Args:
        settings: of the sweep.
        say: tells where the scores come from, if not from the store.

    Raises:
        ConfigError: the sweep names no such metric.
        StoreError: the sweep was not run to its end here.
    """
    metric = settings.sweep.winner
    if metric is None:
        raise ConfigError(
            f"sweep {settings.sweep.name}: sweep.winner is not set, so that none can build on it"
        )
    try:
        sweep = open_sweep(settings, published=PUBLISHED)
    except StoreError as error:
        raise StoreError(
            f"a sweep builds on the winner of {settings.experiment}; run that first ({error})"
        ) from None
    if not sweep.is_from_store:
        say(f"From {sweep.source} (the store holds no such sweep).")
    planned = len(sweep.plan.trials)
    done = len(sweep.trials)
    if done < planned:
        raise StoreError(
            f"{done} of {planned} trials of {settings.experiment} are done; "
            "a sweep builds on its winner, so run it to its end first"
        )
    return best(sweep, metric)


def best(sweep: FinishedSweep, metric: str) -> Winner:
    """The values whose trials have the highest mean of a metric at their last checkpoints.

    Where several have it, the first of them wins.

    Args:
        sweep: with all its trials done.
        metric: such as ``recall_3d/0.7``.

    Raises:
        ConfigError: the metric was not measured for all trials.
    """
    chosen = sweep.select("last").set_index("trial")
    metrics = [str(name) for name in chosen if "/" in str(name) and chosen[name].notna().all()]
    if metric not in metrics:
        raise ConfigError(f"sweep.winner: no metric {metric}. {options(metric, metrics)}")
    replicates: dict[str, list[FrozenTrial]] = {}
    for trial in sweep.trials:
        replicates.setdefault(digest(_without_seed(trial.plan)), []).append(trial.plan)
    means = {
        name: float(chosen.loc[[trial.key for trial in trials], metric].mean())
        for name, trials in replicates.items()
    }
    name = max(means, key=lambda name: means[name])
    return Winner(_overrides(replicates[name][0]), means[name])


def _without_seed(trial: FrozenTrial) -> Mapping[str, object]:
    return {key: value for key, value in trial.values.items() if key != SEED}


def _overrides(trial: FrozenTrial) -> dict[str, str]:
    """Overrides by key; they and the values run in parallel."""
    written = dict(zip(trial.values, trial.overrides, strict=True))
    return {key: text for key, text in written.items() if key != SEED}


def _settings_of(sweep: str, arguments: Sequence[str]) -> Settings:
    """Settings of an earlier sweep in the same place."""
    places = [one for one in arguments if _section(one) in PLACES]
    return read_settings(compose_config([*places, f"+sweep={sweep}"]))


def _section(override: str) -> str:
    return override.lstrip("+").partition("=")[0].partition(".")[0]
