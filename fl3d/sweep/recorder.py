"""Carry what stages leave on disk into the store: each checkpoint once for every trial that it belongs to."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from fl3d.core.errors import CheckpointError, DataError, StoreDown, StoreError
from fl3d.core.nested import leaves
from fl3d.core.records import Trial
from fl3d.evaluation.selection import MEAN_3D, RULES, select
from fl3d.runs.checkpoints import load_state, read_marker, save_state
from fl3d.runs.design import level_text
from fl3d.runs.layout import RunFolder
from fl3d.store.base import CURVE, CURVES, STANDING, RunStatus, Scored, Store
from fl3d.sweep.identity import result_config
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.sweepers.base import Standing, TrialState

Draw = Callable[[Trial, int, Path], list[Path]]
STATUS = {TrialState.FAILED: RunStatus.FAILED, TrialState.STOPPED: RunStatus.STOPPED}
RETRY_SECONDS = 10.0  # between calls to a store that is down


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is written of every trial of a sweep.

    Args:
        experiment: id of the sweep's in the store.
        factor: keys that are compared.
        best_among: where ``best`` looks, see ``evaluation.selection.select``.
        dataset: name and digest of the data.
        data_root: where they lie.
        tags: commit, versions, machine.
        files: put beside each run, such as uncommitted changes: text by name.
        draw: draws a trial's checkpoint into a folder.
    """

    experiment: str
    factor: tuple[str, ...]
    best_among: str
    dataset: tuple[str, str]
    data_root: Path
    tags: Mapping[str, str]
    files: Mapping[str, str]
    draw: Draw


@dataclass
class _Run:
    """A trial's run in the store that is not whole yet: its id, the steps that it holds, and how it was closed."""

    id: str
    logged: set[int]
    closed: RunStatus | None = None


class Recorder:
    """The one process that writes a sweep to the store.

    While the store is down, training continues: what waits lies on disk, and is logged when the store is back.

    Args:
        store: open.
        scores: of the checkpoints.
        subject: what is written of every trial.
        say: prints a line for the user.
    """

    def __init__(
        self, store: Store, scores: Scoreboard, subject: Subject, say: Callable[[str], None] = print
    ) -> None:
        self.store = store
        self.scores = scores
        self.subject = subject
        self.say = say
        self._runs: dict[str, str] = {}  # ids by trial
        self._unfinished: dict[str, _Run] = {}  # by trial; the others are whole, or a file is torn
        self._draws: dict[str, str] = {}  # trial whose run has a stage's curve, by the stage
        self._models: set[tuple[str, str]] | None = (
            None  # that the store held when this start began
        )
        self._retry_at = 0.0

    @property
    def runs(self) -> list[str]:
        """Ids of the runs of all trials."""
        return list(self._runs.values())

    @property
    def is_waiting(self) -> bool:
        """Whether the store was down when it was asked last."""
        return self._retry_at > 0

    def sync(self, standings: Mapping[str, Standing]) -> bool:
        """Log every checkpoint that is on disk and not in the store, and close the runs of trials that have ended.

        Args:
            standings: of the sweep's trials.

        Returns:
            whether the store holds all; False while it is down.
        """
        if time.monotonic() < self._retry_at:
            return False
        try:
            for standing in standings.values():
                self._sync_or_say(standing)
        except StoreDown as error:
            if not self._retry_at:
                self.say(f"The store is down; training continues, scores wait on disk. {error}")
            self._retry_at = time.monotonic() + RETRY_SECONDS
            return False
        if self._retry_at:
            self.say("The store is back; what waited is logged.")
            self._retry_at = 0.0
        return True

    def attach(self, files: list[Path], folder: str) -> None:
        """Put the sweep's tables and figures beside every trial, if the store can be reached."""
        try:
            for run in self.runs:
                self.store.log_files(run, files, folder)
        except StoreDown as error:
            self.say(
                f"The store is down: tables and figures are on disk and not beside the runs; the same command adds "
                f"them. {error}"
            )

    def interrupt(self) -> None:
        """Close the runs of trials that are not done, if the store can be reached; the next start opens them again."""
        try:
            for run in self._unfinished.values():
                if run.closed is None:
                    self.store.end(run.id, RunStatus.STOPPED)
        except (StoreError, OSError):  # down, or its disk is full
            return

    def _sync_or_say(self, standing: Standing) -> None:
        trial = standing.trial
        if trial.key not in self._runs:
            run = self._open(trial)
            self._runs[trial.key], self._unfinished[trial.key] = run.id, run
        if trial.key not in self._unfinished:
            return
        try:
            self._sync(standing, self._unfinished[trial.key])
        except (CheckpointError, DataError) as error:  # the other trials are recorded on
            self.say(f"{trial.key}: not recorded any further: {error}")
            run = self._unfinished.pop(trial.key)
            self.store.end(run.id, RunStatus.FAILED)

    def _sync(self, standing: Standing, run: _Run) -> None:
        trial = standing.trial
        # A run that is closed is not looked at again: it must hold every step.
        listed = self.scores.all_steps if standing.state is TrialState.DONE else self.scores.steps
        for key in trial.stages:
            draws = self._draws.setdefault(key, trial.key) == trial.key
            for step in listed(key):
                if step not in run.logged:
                    scored = self._scored(key, step)
                    self.store.log(run.id, _with_curves(scored) if draws else scored)
                    run.logged.add(step)
        if standing.state is TrialState.DONE:
            if run.closed is not RunStatus.DONE:
                self._finish(trial, run)
            del self._unfinished[trial.key]
            self.scores.let_go(trial.key)
        elif standing.state in STATUS and run.closed is not STATUS[standing.state]:
            self.store.end(run.id, STATUS[standing.state])
            run.closed = STATUS[standing.state]
            self.scores.let_go(trial.key)

    def _open(self, trial: Trial) -> _Run:
        params = dict(leaves(result_config(trial.config)))
        params |= {f"protocol.{key}": value for key, value in leaves(trial.config["protocol"])}
        protocol = self.scores.protocol.id
        tags = {**self.subject.tags, **self._tags(trial)}
        name = run_name(trial, self.subject.factor)
        run = self.store.run(self.subject.experiment, trial.key, protocol, name, tags, params)
        self.store.link_dataset(run, *self.subject.dataset, self.subject.data_root)
        is_whole = self.store.is_finished(run) and self._has_models(run)
        closed = RunStatus.DONE if is_whole else None
        return _Run(run, self.store.logged_steps(run), closed)

    def _has_models(self, run: str) -> bool:
        """Whether a run's models are there: somebody may have deleted them in the UI."""
        if self._models is None:
            self._models = self.store.models(self.subject.experiment)
        return all((run, rule) in self._models for rule in RULES)

    def _tags(self, trial: Trial) -> dict[str, str]:
        return {
            "detector": trial.detector,
            "factor": ", ".join(self.subject.factor),
            "group": trial.group,
            "level": trial.level,
            STANDING: f"{trial.group} {level_text(self.subject.factor, trial.level)}",
            "seed": str(trial.seed),
            "fl3d.overrides": " ".join(trial.overrides),
            "fl3d.stages": " ".join(trial.stages),
            "fl3d.first_own_step": str(trial.first_own_step),
            "fl3d.data_digest": self.subject.dataset[1],
        }

    def _scored(self, key: str, step: int) -> Scored:
        folder = self.scores.folder(key)
        marker = read_marker(folder, step)
        aps = self.scores.aps(key, step)
        values = {**aps, "mean_3d": sum(aps[name] for name in MEAN_3D) / 3}
        values |= {"epoch": marker.epoch}
        values |= {"train/lr": marker.lr} if marker.lr is not None else {}
        values |= {f"loss/{name}": value for name, value in marker.losses.items()}
        values |= {f"seconds/{name}": value for name, value in marker.seconds.items()}
        made = marker.time_ms or int(folder.marker(step).stat().st_mtime * 1000)
        return Scored(step, made, values)

    def _finish(self, trial: Trial, run: _Run) -> None:
        """Log the last and the best checkpoint as models, a picture and the config; close the run."""
        chosen = {rule: self._choose(trial, rule, run.logged) for rule in RULES}
        last = chosen["last"][1]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for rule, (stage, step) in chosen.items():
                self._log_model(run, rule, stage, step, folder)
            texts = {"config.json": json.dumps(trial.config, indent=1) + "\n", **self.subject.files}
            for file, text in texts.items():
                (folder / file).write_text(text, encoding="utf-8")
            self.store.log_files(run.id, [folder / file for file in texts], "")
            self.store.log_files(run.id, self.subject.draw(trial, last, folder), "pictures")
        self.store.set_tags(
            run.id, {f"{rule}_step": str(step) for rule, (_, step) in chosen.items()}
        )
        self.store.end(run.id, RunStatus.DONE)

    def _choose(self, trial: Trial, rule: str, logged: set[int]) -> tuple[str, int]:
        """Stage and step of the logged checkpoint that a rule picks, by the rule that the tables use."""
        rows = [
            {"stage": key, "step": step}
            | {name: self.scores.aps(key, step)[name] for name in MEAN_3D}
            for key in trial.stages
            for step in self.scores.steps(key)
            if step in logged
        ]
        frame = pd.DataFrame(rows).assign(trial=trial.key, first_own_step=trial.first_own_step)
        row = select(frame, rule, self.subject.best_among).iloc[0]
        return str(row["stage"]), int(row["step"])

    def _log_model(self, run: _Run, rule: str, stage: str, step: int, folder: Path) -> None:
        source = self.scores.folder(stage)
        tags = {
            "rule": rule,
            "stage": stage,
            "step": str(step),
            "protocol": self.scores.protocol.id,
        }
        scored = self._scored(stage, step)
        kept = {
            key: value
            for key, value in scored.values.items()
            if key.startswith(("ap_", "mean_", "recall_"))
        }
        files = [*_weights(source, step, folder / f"{rule}.pt"), source.spec]
        aps = Scored(step, scored.time_ms, kept)
        self.store.log_model(
            self.subject.experiment, run.id, rule, files, tags, aps, self.subject.dataset
        )


def _with_curves(scored: Scored) -> Scored:
    """Scores of a checkpoint, with what is drawn over steps under its own names too."""
    drawn = {CURVE + name: scored.values[name] for name in CURVES if name in scored.values}
    return replace(scored, values={**scored.values, **drawn})


def run_name(trial: Trial, factor: Sequence[str]) -> str:
    """What a person calls a trial in a list of runs: group, level and seed."""
    return f"{trial.group} {level_text(factor, trial.level)} seed={trial.seed}"


def _weights(folder: RunFolder, step: int, copy: Path) -> list[Path]:
    """A checkpoint's weights alone, in a file of their own; none where they were not kept."""
    if not folder.weights(step).exists():
        return []
    save_state(
        copy,
        {"model": load_state(folder.weights(step))["model"], "stage": folder.key, "step": step},
    )
    return [copy]
