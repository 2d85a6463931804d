"""Carry what stages leave on disk into the store: each checkpoint once for every trial that it belongs to."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd

from fl3d.evaluation.detections import Validation
from fl3d.evaluation.protocol import Protocol
from fl3d.records import StagePaths, Trial
from fl3d.reports.selection import MEAN_3D, RULES, select
from fl3d.store import Scored, Store
from fl3d.sweep.identity import leaves, result_config
from fl3d.sweep.plan import Plan
from fl3d.training.checkpoints import load_state, read_marker, save_state
from fl3d.training.run import write_scores

Picture = Callable[[Trial, int, Path], list[Path]]


class Recorder:
    """The one process that writes to the store.

    Args:
        store: open.
        experiment: id.
        plan: trials and stages.
        stages_root: folder of all stages.
        validation: frames that scores are on.
        protocol: of the scores.
        selection: where ``best`` looks, see ``reports.selection.select``.
        names: of the detectors, by ``_target_``.
        dataset: name and digest of the data.
        data_root: where it lies.
        tags: of every run: commit, versions, machine.
        picture: draws a trial's checkpoint into a folder.
    """

    def __init__(
        self,
        store: Store,
        experiment: str,
        plan: Plan,
        stages_root: Path,
        validation: Validation,
        protocol: Protocol,
        selection: str,
        names: Mapping[str, str],
        dataset: tuple[str, str],
        data_root: Path,
        tags: Mapping[str, str],
        picture: Picture,
    ) -> None:
        self.store, self.experiment, self.plan, self.stages_root = store, experiment, plan, stages_root
        self.validation, self.protocol, self.names, self.dataset = validation, protocol, names, dataset
        self.picture, self.selection = picture, selection
        self.runs: dict[str, str] = {}
        self.logged: dict[str, set[int]] = {}
        self.finished: set[str] = set()
        for trial in plan.trials:
            run = self._open(trial, tags)
            self.runs[trial.key], self.logged[trial.key] = run, store.logged_steps(run)
            store.link_dataset(run, *dataset, data_root)
            if store.is_finished(run):
                self.finished.add(trial.key)

    def _open(self, trial: Trial, tags: Mapping[str, str]) -> str:
        config = trial.config
        detector = self.names[config["detector"]["_target_"]]
        gamma = config["loss"].get("gamma", 0.0)
        last = self.plan.stages[trial.stages[-1]]
        own = {
            "detector": detector,
            "gamma": f"{gamma:g}",
            "loss": "BCE" if gamma == 0 else "focal",
            "seed": str(config["seed"]),
            "fl3d.stages": " ".join(trial.stages),
            "fl3d.first_own_step": str(last.start_step),
            "fl3d.data_digest": self.dataset[1],
        }
        name = f"{detector} γ={gamma:g} seed={config['seed']}"
        params = dict(leaves(result_config(config))) | {f"protocol.{k}": v for k, v in leaves(config["protocol"])}
        return self.store.run(self.experiment, trial.key, self.protocol.id, name, {**tags, **own}, params)

    def sync(self) -> None:
        """Log every checkpoint that is on disk and not in the store, and close the trials that are done."""
        for trial in self.plan.trials:
            if trial.key in self.finished:
                continue
            for key in trial.stages:
                paths = StagePaths(self.stages_root / key)
                for step in paths.steps():
                    if step not in self.logged[trial.key]:
                        self.store.log(self.runs[trial.key], self._scored(paths, step))
                        self.logged[trial.key].add(step)
            if StagePaths(self.stages_root / trial.key).done.exists():
                self._finish(trial)

    def _scored(self, paths: StagePaths, step: int) -> Scored:
        write_scores(paths, step, self.validation, self.protocol)
        marker, aps = read_marker(paths, step), _read_aps(paths, step, self.protocol)
        values = {**aps, "mean_3d": sum(aps[k] for k in MEAN_3D) / 3, "epoch": marker.epoch, "train/lr": marker.lr}
        values |= {f"loss/{name}": value for name, value in marker.losses.items()}
        values |= {f"seconds/{name}": value for name, value in marker.seconds.items()}
        return Scored(step, int(paths.marker(step).stat().st_mtime * 1000), values)

    def _finish(self, trial: Trial) -> None:
        """Log the last and the best checkpoint as models, a picture and the config; close the run."""
        run = self.runs[trial.key]
        chosen = {rule: self._choose(trial, rule) for rule in RULES}
        last = chosen["last"][1]
        with tempfile.TemporaryDirectory() as folder:
            for rule, (stage, step) in chosen.items():
                self._log_model(trial, rule, stage, step, Path(folder))
            config = Path(folder) / "config.json"
            config.write_text(json.dumps(trial.config, indent=1) + "\n")
            self.store.log_files(run, [config], "")
            self.store.log_files(run, self.picture(trial, last, Path(folder)), "pictures")
        self.store.set_tags(run, {f"{rule}_step": str(step) for rule, (_, step) in chosen.items()})
        self.store.end(run, "FINISHED")
        self.finished.add(trial.key)

    def _choose(self, trial: Trial, rule: str) -> tuple[str, int]:
        """Stage and step of the checkpoint that a rule picks, by the rule that the tables use."""
        rows = []
        for key in trial.stages:
            paths = StagePaths(self.stages_root / key)
            rows += [{"stage": key, "step": s, **_read_aps(paths, s, self.protocol)} for s in paths.steps()]
        first = self.plan.stages[trial.key].start_step
        frame = pd.DataFrame(rows).assign(trial=trial.key, first_own_step=first)
        row = select(frame, rule, self.selection).iloc[0]
        return str(row["stage"]), int(row["step"])

    def _log_model(self, trial: Trial, rule: str, stage: str, step: int, folder: Path) -> None:
        run, paths = self.runs[trial.key], StagePaths(self.stages_root / stage)
        weights = folder / f"{rule}.pt"
        save_state(weights, {"model": load_state(paths.weights(step))["model"], "stage": stage, "step": step})
        tags = {"rule": rule, "stage": stage, "step": str(step), "protocol": self.protocol.id}
        scored = self._scored(paths, step)
        aps = Scored(step, scored.time_ms, {k: v for k, v in scored.values.items() if k.startswith(("ap_", "mean_"))})
        self.store.log_model(self.experiment, run, rule, [weights, paths.spec], tags, aps, self.dataset)

    def attach(self, files: list[Path], folder: str) -> None:
        """Put the sweep's tables and figures beside every trial."""
        for run in self.runs.values():
            self.store.log_files(run, files, folder)

    def interrupt(self) -> None:
        """Close the runs of trials that are not done; the next start opens them again."""
        for trial in self.plan.trials:
            if trial.key not in self.finished:
                self.store.end(self.runs[trial.key], "KILLED")

    def fail(self, failed: set[str]) -> None:
        """Close the runs of trials that hold any of these stages as failed."""
        for trial in self.plan.trials:
            if failed & set(trial.stages):
                self.store.end(self.runs[trial.key], "FAILED")


def _read_aps(paths: StagePaths, step: int, protocol: Protocol) -> dict[str, float]:
    values: dict[str, float] = json.loads(paths.scores(step, protocol.id).read_text())
    return values
