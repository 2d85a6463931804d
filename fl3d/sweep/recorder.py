"""Carry what stages leave on disk into the store: each checkpoint once for every trial that it belongs to."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd

from fl3d.errors import CheckpointError, DataError, StoreDown
from fl3d.records import StagePaths, Trial
from fl3d.reports.selection import MEAN_3D, RULES, select
from fl3d.store.tracking import Scored, Store
from fl3d.sweep.identity import leaves, result_config
from fl3d.sweep.plan import Plan
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.training.checkpoints import load_state, read_marker, save_state

Picture = Callable[[Trial, int, Path], list[Path]]
UNREADABLE = "UNREADABLE"  # a trial with a file that is torn: the others go on
SAY_SECONDS = 60.0
RETRY_SECONDS = 10.0  # between calls to a store that is down


class Recorder:
    """The one process that writes a sweep to the store.

    While the store is down, training goes on: what waits lies on disk, and is logged when the store is back.

    Args:
        store: open.
        experiment: id.
        scores: of the checkpoints.
        selection: where ``best`` looks, see ``reports.selection.select``.
        names: of the detectors, by ``_target_``; may grow.
        dataset: name and digest of the data.
        data_root: where it lies.
        tags: of every run: commit, versions, machine.
        files: put beside every run, such as uncommitted changes.
        picture: draws a trial's checkpoint into a folder.
        say: prints a line for the user.
    """

    def __init__(
        self,
        store: Store,
        experiment: str,
        scores: Scoreboard,
        selection: str,
        names: Mapping[str, str],
        dataset: tuple[str, str],
        data_root: Path,
        tags: Mapping[str, str],
        files: Mapping[str, str],
        picture: Picture,
        say: Callable[[str], None] = print,
    ) -> None:
        self.store, self.experiment, self.scores, self.selection = store, experiment, scores, selection
        self.names, self.dataset, self.data_root = names, dataset, data_root
        self.tags, self.files, self.picture, self.say = tags, files, picture, say
        self.runs: dict[str, str] = {}
        self.logged: dict[str, set[int]] = {}
        self.closed: dict[str, str] = {}
        self._retry_at = 0.0

    def sync(self, plan: Plan, ended: Mapping[str, str] | None = None) -> bool:
        """Log every checkpoint that is on disk and not in the store, and close the runs of trials that have ended.

        Args:
            plan: of the sweep, as far as it has grown.
            ended: MLflow's status (``FAILED``, ``KILLED``) of trials that ended before they were done.

        Returns:
            whether the store holds all; False while it is down.
        """
        if time.monotonic() < self._retry_at:
            return False
        try:
            for trial in plan.trials:
                if self.closed.get(trial.key) not in ("FINISHED", UNREADABLE):
                    self._sync_or_say(trial, plan, (ended or {}).get(trial.key))
        except StoreDown as error:
            if not self._retry_at:
                self.say(f"The store is down; training goes on, scores wait on disk. {error}")
            self._retry_at = time.monotonic() + RETRY_SECONDS
            return False
        if self._retry_at:
            self.say("The store is back; what waited is logged.")
            self._retry_at = 0.0
        return True

    def _sync_or_say(self, trial: Trial, plan: Plan, status: str | None) -> None:
        try:
            self._sync(trial, plan, status)
        except (CheckpointError, DataError) as error:
            self.say(f"{trial.key}: not recorded any further: {error}")
            self.closed[trial.key] = UNREADABLE

    def finish(self, plan: Plan, ended: Mapping[str, str]) -> None:
        """As ``sync``, but wait for a store that is down."""
        said = time.monotonic()
        while not self.sync(plan, ended):
            time.sleep(0.5)
            if time.monotonic() - said > SAY_SECONDS:
                said = time.monotonic()
                self.say(
                    "All is trained. Waiting for the store, to log what is on disk; Ctrl-C and a later start do it too."
                )

    def _sync(self, trial: Trial, plan: Plan, status: str | None) -> None:
        if trial.key not in self.runs:
            self._open(trial, plan)
        for key in trial.stages:
            for step in self.scores.steps(key):
                if step not in self.logged[trial.key]:
                    self.store.log(self.runs[trial.key], self._scored(key, step))
                    self.logged[trial.key].add(step)
        if self.scores.paths(trial.key).done.exists():
            if self.closed.get(trial.key) != "FINISHED":
                self._finish(trial, plan)
                self.closed[trial.key] = "FINISHED"
        elif status is not None and self.closed.get(trial.key) != status:
            self.store.end(self.runs[trial.key], status)
            self.closed[trial.key] = status

    def _open(self, trial: Trial, plan: Plan) -> None:
        last = plan.stages[trial.key]
        detector = self.names[trial.config["detector"]["_target_"]]
        gamma, seed = last.config["loss"].get("gamma", 0.0), trial.config["seed"]
        own = {
            "detector": detector,
            "gamma": f"{gamma:g}",
            "loss": "BCE" if gamma == 0 else "focal",
            "seed": str(seed),
            "fl3d.overrides": " ".join(trial.overrides),
            "fl3d.stages": " ".join(trial.stages),
            "fl3d.first_own_step": str(last.start_step),
            "fl3d.data_digest": self.dataset[1],
        }
        params = dict(leaves(result_config(trial.config)))
        params |= {f"protocol.{k}": v for k, v in leaves(trial.config["protocol"])}
        name = _run_name(trial, detector, gamma, seed)
        tags, protocol = {**self.tags, **own}, self.scores.protocol.id
        run = self.store.run(self.experiment, trial.key, protocol, name, tags, params)
        self.store.link_dataset(run, *self.dataset, self.data_root)
        self.logged[trial.key] = self.store.logged_steps(run)
        if self.store.is_finished(run):
            self.closed[trial.key] = "FINISHED"
        self.runs[trial.key] = run

    def _scored(self, key: str, step: int) -> Scored:
        paths = self.scores.paths(key)
        marker, aps = read_marker(paths, step), self.scores.aps(key, step)
        values = {**aps, "mean_3d": sum(aps[k] for k in MEAN_3D) / 3, "epoch": marker.epoch, "train/lr": marker.lr}
        values |= {f"loss/{name}": value for name, value in marker.losses.items()}
        values |= {f"seconds/{name}": value for name, value in marker.seconds.items()}
        return Scored(step, marker.time_ms or int(paths.marker(step).stat().st_mtime * 1000), values)

    def _finish(self, trial: Trial, plan: Plan) -> None:
        """Log the last and the best checkpoint as models, a picture and the config; close the run."""
        run = self.runs[trial.key]
        chosen = {rule: self._choose(trial, plan, rule) for rule in RULES}
        last = chosen["last"][1]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for rule, (stage, step) in chosen.items():
                self._log_model(trial, rule, stage, step, folder)
            texts = {"config.json": json.dumps(trial.config, indent=1) + "\n", **self.files}
            for called, text in texts.items():
                (folder / called).write_text(text)
            self.store.log_files(run, [folder / called for called in texts], "")
            self.store.log_files(run, self.picture(trial, last, folder), "pictures")
        self.store.set_tags(run, {f"{rule}_step": str(step) for rule, (_, step) in chosen.items()})
        self.store.end(run, "FINISHED")

    def _choose(self, trial: Trial, plan: Plan, rule: str) -> tuple[str, int]:
        """Stage and step of the checkpoint that a rule picks, by the rule that the tables use."""
        rows = [
            {"stage": key, "step": step, **self.scores.aps(key, step)}
            for key in trial.stages
            for step in self.scores.paths(key).steps()
        ]
        frame = pd.DataFrame(rows).assign(trial=trial.key, first_own_step=plan.stages[trial.key].start_step)
        row = select(frame, rule, self.selection).iloc[0]
        return str(row["stage"]), int(row["step"])

    def _log_model(self, trial: Trial, rule: str, stage: str, step: int, folder: Path) -> None:
        run, paths = self.runs[trial.key], self.scores.paths(stage)
        tags = {"rule": rule, "stage": stage, "step": str(step), "protocol": self.scores.protocol.id}
        scored = self._scored(stage, step)
        aps = Scored(
            step, scored.time_ms, {k: v for k, v in scored.values.items() if k.startswith(("ap_", "mean_", "recall_"))}
        )
        files = [*_weights(paths, step, folder / f"{rule}.pt"), paths.spec]
        self.store.log_model(self.experiment, run, rule, files, tags, aps, self.dataset)

    def attach(self, files: list[Path], folder: str) -> None:
        """Put the sweep's tables and figures beside every trial."""
        for run in self.runs.values():
            self.store.log_files(run, files, folder)

    def interrupt(self) -> None:
        """Close the runs of trials that are not done, if the store can be reached; the next start opens them again."""
        try:
            for key, run in self.runs.items():
                if key not in self.closed:
                    self.store.end(run, "KILLED")
        except StoreDown:
            return


def _weights(paths: StagePaths, step: int, copy: Path) -> list[Path]:
    """A checkpoint's weights alone, in a file of their own; none where they were not kept."""
    if not paths.weights(step).exists():
        return []
    save_state(copy, {"model": load_state(paths.weights(step))["model"], "stage": paths.folder.name, "step": step})
    return [copy]


def _run_name(trial: Trial, detector: str, gamma: float, seed: int) -> str:
    """What a person calls a trial: detector and gamma, what else was swept, and the seed."""
    swept = [override.partition("=") for override in trial.overrides]
    others = [(key, value) for key, _, value in swept if key not in ("detector", "loss.gamma", "seed")]
    rest = [f"{key.rpartition('.')[2]}={_short(value)}" for key, value in others]
    return " ".join([detector, f"γ={gamma:g}", *rest, f"seed={seed}"])


def _short(value: str) -> str:
    try:
        return f"{float(value):.4g}"
    except ValueError:
        return value
