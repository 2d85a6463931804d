"""What a study has found: its best trials or its Pareto front, and all trials as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import optuna
import pandas as pd
from optuna.trial import FrozenTrial, TrialState

from fl3d.core.files import write_text

SHOWN = 10  # best trials
KEY = "fl3d.trial"  # attribute of a trial in the study: its key


def report_study(
    study: optuna.Study,
    objectives: Sequence[str],
    axes: Sequence[str],
    sweep: str,
    folder: Path,
) -> str:
    """Write ``tables/study_<sweep>.csv`` and ``.md``, and return the Markdown.

    Args:
        study: with all its trials told.
        objectives: names of its values.
        axes: keys that were searched.
        sweep: name of the sweep.
        folder: of the results.
    """
    trials = study.get_trials(deepcopy=False)
    if not trials:
        return ""
    is_front = len(objectives) > 1
    shown = _front(study) if is_front else _best(trials)
    title = "Pareto front" if is_front else "best trials"
    counts = {state: sum(trial.state is state for trial in trials) for state in TrialState}
    states = ", ".join(f"{count} {state.name.lower()}" for state, count in counts.items() if count)
    lines = [
        f"**Study {study.study_name}**, {title} by {', '.join(objectives)}; trials: {states}.",
        "",
        _line(["trial", *(axis.lstrip("+") for axis in axes), *objectives]),
        "|---" * (1 + len(axes)) + "|---:" * len(objectives) + "|",
    ]
    for trial in sorted(shown, key=lambda trial: -trial.values[0]):
        searched = [_text(trial.params.get(axis)) for axis in axes]
        values = [f"{value:.2f}" for value in trial.values]
        lines.append(_line([str(trial.number), *searched, *values]))
    text = "\n".join(lines) + "\n"
    frame = pd.DataFrame([_row(trial, objectives, axes) for trial in trials])
    tables = folder / "tables"
    write_text(tables / f"study_{sweep}.md", text)
    write_text(tables / f"study_{sweep}.csv", frame.to_csv(index=False, lineterminator="\n"))
    return "\n" + text


def _once(trials: Sequence[FrozenTrial], of: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Trials without those whose point came before: a point that came twice is shown once."""
    first = {trial.user_attrs.get(KEY, trial.number): trial.number for trial in reversed(of)}
    return [trial for trial in trials if trial.number in first.values()]


def _front(study: optuna.Study) -> list[FrozenTrial]:
    return _once(study.best_trials, study.get_trials(deepcopy=False))


def _best(trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    done = [trial for trial in _once(trials, trials) if trial.state is TrialState.COMPLETE]
    return sorted(done, key=lambda trial: -trial.values[0])[:SHOWN]


def _row(trial: FrozenTrial, objectives: Sequence[str], axes: Sequence[str]) -> dict[str, object]:
    values = trial.values or [None] * len(objectives)
    front: dict[str, object] = {
        "number": trial.number,
        "state": trial.state.name.lower(),
        "last_epoch": max(trial.intermediate_values, default=None),
    }
    searched = {axis.lstrip("+"): trial.params.get(axis) for axis in axes}
    return front | searched | dict(zip(objectives, values, strict=True))


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
