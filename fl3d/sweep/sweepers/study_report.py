"""What a study has found: its best trials or its Pareto front, and all trials as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import optuna
import pandas as pd
from optuna.trial import FrozenTrial, TrialState

from fl3d.files import write_text

SHOWN = 10  # best trials
KEY = "fl3d.trial"  # attribute of a trial in the study: its key


def report_study(study: optuna.Study, objectives: Sequence[str], axes: Sequence[str], sweep: str, folder: Path) -> str:
    """Write ``tables/study_<sweep>.csv`` and ``.md``, and return the Markdown.

    Args:
        study: with all its trials told.
        objectives: names of its values.
        axes: keys that were searched.
        sweep: name of the sweep.
        folder: of the results.
    """
    trials = study.get_trials(deepcopy=False)
    rows = [_row(trial, objectives, axes) for trial in trials]
    if not rows:
        return ""
    first = {trial.user_attrs.get(KEY, trial.number): trial.number for trial in reversed(trials)}
    own = [trial for trial in trials if trial.number in first.values()]  # a point that came twice is shown once
    done = [trial for trial in own if trial.state is TrialState.COMPLETE]
    counts = {state: sum(trial.state is state for trial in trials) for state in TrialState}
    said = ", ".join(f"{count} {state.name.lower()}" for state, count in counts.items() if count)
    is_front = len(objectives) > 1
    if is_front:
        front = {trial.number for trial in study.best_trials}
        chosen = [trial for trial in own if trial.number in front]
    else:
        chosen = sorted(done, key=lambda t: -t.values[0])[:SHOWN]
    title = "Pareto front" if is_front else "best trials"
    lines = [f"**Study {study.study_name}**, {title} by {', '.join(objectives)}; trials: {said}.", ""]
    head = ["trial", *(axis.lstrip("+") for axis in axes), *objectives]
    lines += ["| " + " | ".join(head) + " |", "|---" * (1 + len(axes)) + "|---:" * len(objectives) + "|"]
    for trial in sorted(chosen, key=lambda t: -t.values[0]):
        cells = [str(trial.number), *(_text(trial.params.get(a)) for a in axes), *(f"{v:.2f}" for v in trial.values)]
        lines.append("| " + " | ".join(cells) + " |")
    text = "\n".join(lines) + "\n"
    write_text(folder / "tables" / f"study_{sweep}.md", text)
    frame = pd.DataFrame(rows)
    write_text(folder / "tables" / f"study_{sweep}.csv", frame.to_csv(index=False, lineterminator="\n"))
    return "\n" + text


def _row(trial: FrozenTrial, objectives: Sequence[str], axes: Sequence[str]) -> dict[str, object]:
    values = trial.values or [None] * len(objectives)
    reported = max(trial.intermediate_values, default=None)
    front: dict[str, object] = {"number": trial.number, "state": trial.state.name.lower(), "last_epoch": reported}
    searched = {axis.lstrip("+"): trial.params.get(axis) for axis in axes}
    return front | searched | dict(zip(objectives, values, strict=True))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
