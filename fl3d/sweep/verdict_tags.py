"""Carry a sweep's verdicts into its store: a tag of every run, and sentences above the runs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.verdicts import findings, gain_text, verdict_text
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.store.base import Store
from fl3d.sweep.notes import note


def tag_verdicts(sweep: FinishedSweep, verdicts: pd.DataFrame, store: Store) -> None:
    """Tag every run with its level's verdict, and put what was found above the runs.

    Args:
        sweep: whose runs are in the store.
        verdicts: of it, see ``analysis.verdicts.judge``.
        store: open.
    """
    settings = sweep.settings
    margin = settings.sweep.margin
    tags = {(row["group"], row["level"]): _tags(row, margin) for row in verdicts.to_dict("records")}
    runs = sweep.runs(store)
    for trial in sweep.trials:
        place = (trial.group, trial.level)
        if trial.key in runs and place in tags:
            store.set_tags(runs[trial.key], tags[place])
    sentences = findings(verdicts, levels_of(sweep), margin)
    store.experiment(settings.stored_as, note(settings, sentences))


def _tags(row: Mapping[Hashable, Any], margin: float) -> dict[str, str]:
    is_baseline = row["verdict"] == Verdict.BASELINE
    return {
        "verdict": str(row["verdict"]),  # one word, to search by: tags.verdict = "better"
        "verdict.text": verdict_text(row, margin),
        "verdict.metric": str(row["metric"]),
        "verdict.seeds": str(row["seeds"]),
        "gain": "" if is_baseline else gain_text(row),
    }
