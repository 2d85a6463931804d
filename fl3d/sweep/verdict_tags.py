"""Carry a sweep's verdicts into its store: a tag of every run, and sentences above the runs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.verdicts import (
    gain_text,
    in_short,
    seeds_text,
    verdict_tables,
    verdict_text,
    verdict_word,
)
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.store.base import STANDING, Store
from fl3d.sweep.notes import note

LEFT_OUT = "left out"  # what the verdict of a run is whose trial the sweep has no longer


def tag_verdicts(sweep: FinishedSweep, verdicts: pd.DataFrame, store: Store) -> None:
    """Tag every run with its level's verdict, and put what was found above the runs.

    Args:
        sweep: whose runs are in the store.
        verdicts: of it, see ``analysis.verdicts.judge``.
        store: open.
    """
    settings = sweep.settings
    margin = settings.sweep.margin
    levels = levels_of(sweep)
    rows = {(row["group"], row["level"]): row for row in verdicts.to_dict("records")}
    runs = sweep.runs(store)
    for trial in sweep.trials:
        row = rows.get((trial.group, trial.level))
        if trial.key in runs and row is not None:
            where = f"{trial.group} {levels.text(trial.level)}"
            store.set_tags(runs[trial.key], _tags(row, margin, where))
    for run in sorted(set(store.read(settings.stored_as)["run"]) - set(runs.values())):
        text = f"{LEFT_OUT}: of an earlier start"
        store.set_tags(run, {"verdict": LEFT_OUT, "verdict.text": text, STANDING: text, "gain": ""})
    tables = verdict_tables(verdicts, levels, margin, (seeds_text(verdicts),))
    store.experiment(settings.stored_as, note(settings, in_short(verdicts, levels), tables))


def _tags(row: Mapping[Hashable, Any], margin: float, where: str) -> dict[str, str]:
    is_baseline = row["verdict"] == Verdict.BASELINE
    return {
        STANDING: f"{where}: {verdict_word(row)}",
        "verdict": str(row["verdict"]),  # one word, to search by: tags.verdict = "better"
        "verdict.text": verdict_text(row, margin),
        "verdict.metric": str(row["metric"]),
        "verdict.seeds": str(row["seeds"]),
        "gain": "" if is_baseline else gain_text(row),
    }
