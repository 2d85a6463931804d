"""Finished sweeps that nobody ran: real configs and designs, and scores as a test wants them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from fl3d.config.compose import Multirun, multirun
from fl3d.config.objects import locate
from fl3d.config.overrides import values_by_key
from fl3d.config.settings import read_settings
from fl3d.core.nested import leaves
from fl3d.core.records import Config
from fl3d.evaluation.protocol import METRIC_NAMES
from fl3d.reports.table import AP_COLUMNS
from fl3d.runs.design import baseline_level, make_design
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import FrozenPlan, FrozenTrial, write_plan
from fl3d.runs.scores import tidy
from fl3d.runs.spec import write_done
from fl3d.runs.trials import FinishedTrial
from fl3d.store.base import Scored
from fl3d.store.opening import open_store
from fl3d.sweep.identity import result_config

NOWHERE = Path("nowhere")
Aps = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Made:
    """A trial and its scores.

    Args:
        overrides: as a user would write them; the swept ones.
        scores: metrics by step.
        first_own_step: step at which its last stage begins.
        first_stage: key of its first stage, where it has two.
    """

    overrides: tuple[str, ...]
    scores: Mapping[int, Aps]
    first_own_step: int = 0
    first_stage: str = ""


def aps(value: float = 0.0, **others: float) -> dict[str, float]:
    """Every AP at one value, but for those named as the columns of a table: ``3d_easy=50``."""
    return {
        **dict.fromkeys(METRIC_NAMES, value),
        **{AP_COLUMNS[key]: ap for key, ap in others.items()},
    }


def printed_aps(row: Mapping[Any, Any]) -> dict[str, float]:
    """The APs of a row of a published table."""
    return aps(**{column: float(row[column]) for column in AP_COLUMNS})


@cache
def _multirun(words: tuple[str, ...]) -> Multirun:
    return multirun(words)


@cache
def _config(words: tuple[str, ...], overrides: tuple[str, ...]) -> Config:
    composed = _multirun(words)
    return composed.compose([*composed.arguments, *overrides])


def finished_sweep(
    words: Sequence[str], made: Sequence[Made], root: Path = NOWHERE
) -> FinishedSweep:
    """A sweep of some trials, whose scores alone are at hand.

    Args:
        words: what all its trials share.
        made: its trials, in the sweep's order.
        root: below which its store and its results would lie.
    """
    given = tuple(words)
    settings = read_settings(_multirun(given).base)
    store = replace(settings.store, root=root / "runs")
    settings = replace(settings, store=store, results=root / "results")
    swept = list(values_by_key(made[0].overrides))
    design = make_design(swept, settings.sweep)
    trials = []
    raw = []
    for one in made:
        values = {key: value for key, (value,) in values_by_key(one.overrides).items()}
        config = _config(given, one.overrides)
        detector = locate(config["detector"]["_target_"], "detector").NAME
        key = " ".join([detector, *one.overrides])
        trial = FrozenTrial(
            key=key,
            overrides=one.overrides,
            values=values,
            config=dict(leaves(result_config(config))),
            stages=(one.first_stage, key) if one.first_stage else (key,),
            first_own_step=one.first_own_step,
            detector=detector,
            group=design.group(values, config, detector),
            level=design.level(values, config, detector),
            seed=config["seed"],
        )
        trials.append(trial)
        front = {"run": key, "trial": key, "protocol": settings.protocol.id, "epoch": 1}
        raw += [{**front, "step": step, **scores} for step, scores in one.scores.items()]
    levels = list(dict.fromkeys(trial.level for trial in trials))
    baseline = baseline_level(levels, design.factor, settings.sweep.baseline)
    return FinishedSweep(
        settings=settings,
        plan=FrozenPlan(factor=design.factor, baseline=baseline, trials=tuple(trials)),
        trials=tuple(FinishedTrial(trial, ()) for trial in trials),
        scores=tidy(pd.DataFrame(raw), trials, settings.protocol),
        source=root,
    )


def store_scores(sweep: FinishedSweep) -> None:
    """Put a sweep's plan, ends and scores into its store, as a run of it would."""
    layout = StoreFolder(sweep.settings.store.root)
    write_plan(layout.plan(sweep.settings.experiment), sweep.plan)
    store = open_store(sweep.settings.store.root, sweep.settings.store.uri)
    store.open()
    experiment = store.experiment(sweep.settings.experiment, "")
    for trial in sweep.trials:
        run = store.run(experiment, trial.key, sweep.protocol.id, trial.key, {}, {})
        for row in sweep.scores[sweep.scores["trial"] == trial.key].to_dict("records"):
            values = {name: row[name] for name in METRIC_NAMES} | {"epoch": row["epoch"]}
            store.log(run, Scored(row["step"], 1, values))
        write_done(layout.run(trial.key), {})
