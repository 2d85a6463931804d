"""Opens a finished sweep: the one reader of what a store folder, or a results folder, holds of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from fl3d.config.settings import Settings
from fl3d.core.errors import StoreError
from fl3d.core.plurals import several
from fl3d.evaluation.protocol import Protocol
from fl3d.runs.asked import Asked, asked_for
from fl3d.runs.design import refuse_other_design
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import read_plan
from fl3d.runs.scores import lacking, read_score_file, score_file, tidy
from fl3d.runs.trials import FinishedTrial
from fl3d.store.opening import open_store

NAMED = 3  # scores that an error names one by one


def open_sweep(
    settings: Settings, asked: Asked | None = None, published: Path | None = None
) -> FinishedSweep:
    """Open a sweep that was run before: from the store, or else from a file of its scores.

    Args:
        settings: of the sweep.
        asked: values by key: of the sweep's trials those that have one of them.
        published: folder of results that were published, tried after ``settings.results``; None: none.

    Raises:
        StoreError: no trial of it is done, or none is asked for.
        ConfigError: it compares another factor than ``sweep.factor``.
    """
    found, unshown = _from_store(settings)
    if found is None:
        found = open_scores(settings, published, unshown)
    refuse_other_design(settings.sweep, found.factor, settings.experiment)
    return asked_for(found, asked or {})


def is_stored(settings: Settings, published: Path | None = None) -> bool:
    """Whether a sweep was planned in the store, or a results folder holds its scores."""
    places = [settings.results, *([published] if published else [])]
    files = [score_file(place / settings.folder_name, settings.sweep.name) for place in places]
    plan = StoreFolder(settings.store.root).plan(settings.experiment)
    return plan.exists() or any(file.exists() for file in files)


def _from_store(settings: Settings) -> tuple[FinishedSweep | None, dict[str, str]]:
    """The sweep (None: the store shows no trial of it), and why trials that are done are not shown, by their keys."""
    layout = StoreFolder(settings.store.root)
    path = layout.plan(settings.experiment)
    if not path.exists():
        return None, {}
    plan = read_plan(path)
    trials = [
        FinishedTrial(trial, tuple(layout.run(key) for key in trial.stages))
        for trial in plan.trials
        if layout.run(trial.key).is_done
    ]
    raw = open_store(settings.store.root, settings.store.uri).read(settings.stored_as)
    unshown = _unshown(raw, trials, settings.protocol)
    shown = tuple(trial for trial in trials if trial.key not in unshown)
    scores = tidy(raw, [trial.plan for trial in shown], settings.protocol)
    if scores.empty:
        return None, unshown
    sweep = FinishedSweep(
        settings=settings,
        plan=plan,
        trials=shown,
        scores=scores,
        source=settings.store.root,
        unshown=unshown,
    )
    return sweep, unshown


def _unshown(
    raw: pd.DataFrame, trials: Sequence[FinishedTrial], protocol: Protocol
) -> dict[str, str]:
    """Why trials that are done are not shown, by their keys.

    Where the store lacks a step of one (it was down, or nobody has written it yet), a checkpoint from the middle of its
    training would stand as its last model.
    """
    held: dict[str, set[int]] = {}
    if not raw.empty:
        own = raw[raw["protocol"] == protocol.id]
        for key, step in zip(own["trial"], own["step"], strict=True):
            held.setdefault(str(key), set()).add(int(step))
    short = lacking(raw, [trial.plan for trial in trials], protocol)
    why = {}
    for trial in trials:
        if trial.key not in held:
            why[trial.key] = f"scores under protocol {protocol.id} are not in the store"
        elif not trial.steps <= held[trial.key]:
            step = min(trial.steps - held[trial.key])
            why[trial.key] = (
                f"scores of step {step} are not in the store, where the sweep's command logs them (if its detections "
                "are damaged, verify says so)"
            )
        elif trial.key in short:
            names = short[trial.key]
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            why[trial.key] = f"scores lack {', '.join(names[:NAMED])}{more}"
    return why


def open_scores(
    settings: Settings, published: Path | None = None, unshown: Mapping[str, str] | None = None
) -> FinishedSweep:
    """Open a sweep from a file of its scores, whatever the store holds.

    Args:
        settings: of the sweep.
        published: see ``open_sweep``.
        unshown: why trials that are done have no scores in the store, by their keys.

    Raises:
        StoreError: there is no such file.
    """
    places = [settings.results, *([published] if published else [])]
    files = [score_file(place / settings.folder_name, settings.sweep.name) for place in places]
    file = next((file for file in files if file.exists()), None)
    if file is None:
        tried = " or ".join(str(file) for file in files)
        layout = StoreFolder(settings.store.root)
        planned = layout.plan(settings.experiment)
        asked = read_plan(planned).trials if planned.exists() else ()
        if asked and not any(layout.run(trial.key).is_done for trial in asked):
            raise StoreError(
                f"{settings.experiment}: none of its {len(asked)} trials is done yet; the command that started it "
                "resumes it"
            )
        if unshown:
            raise StoreError(
                f"{settings.experiment}: {several(len(unshown), 'trial')} done, and none to show: its "
                f"{next(iter(unshown.values()))}; the command that started it scores what is stored, and trains "
                "nothing again"
            )
        raise StoreError(
            f"{settings.store.root}: no scores of {settings.experiment}, and none in {tried}; run the sweep first"
        )
    plan, scores = read_score_file(file, settings.protocol)
    done = set(scores["trial"])
    trials = tuple(FinishedTrial(trial, ()) for trial in plan.trials if trial.key in done)
    return FinishedSweep(settings=settings, plan=plan, trials=trials, scores=scores, source=file)
