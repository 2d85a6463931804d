"""Run a sweep from configs to tables."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from fl3d.config import build, locate
from fl3d.data.kitti import KittiFolder
from fl3d.data.prepare import PreparedData, prepare_data
from fl3d.digests import digest
from fl3d.errors import ConfigError, options
from fl3d.evaluation.detections import Validation, read_detections, read_validation, to_labels
from fl3d.evaluation.protocol import Protocol
from fl3d.files import write_text
from fl3d.locks import locked
from fl3d.provenance import provenance
from fl3d.records import Config, StagePaths, Trial
from fl3d.reports.figures import birds_eye
from fl3d.reports.selection import STAGES
from fl3d.results import names, stored_scores, summary, write_report
from fl3d.store import Store
from fl3d.sweep.identity import result_config
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.plan import DataInfo, Plan, make_plan
from fl3d.sweep.progress import Progress
from fl3d.sweep.recorder import Recorder
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.training.build import build_detector, build_optimizer
from fl3d.training.trainer import VERSION as TRAINER_VERSION

# Config sections that all trials of a sweep share: one dataset, one protocol, one store.
SHARED = ("data", "protocol", "store", "results", "device", "workers", "profile", "sweep", "selection")

Trials = Sequence[tuple[Sequence[str], Config]]


class Sweep:
    """A sweep on this machine.

    Args:
        trials: overrides and resolved config of each.
        say: prints a line for the user.

    Raises:
        ConfigError: there are none, or they differ in what all must share.
        DataError: the data cannot be used.
    """

    def __init__(self, trials: Trials, say: Callable[[str], None] = print) -> None:
        if not trials:
            raise ConfigError("a sweep needs at least one trial")
        self.config = trials[0][1]
        for key in SHARED:
            if any(config[key] != self.config[key] for _, config in trials):
                raise ConfigError(f"{key}: all trials of a sweep must share it; run one sweep for each value")
        self.say = say
        self.names = names(self.config)
        self.protocol = Protocol(**self.config["protocol"])
        self.data = prepare_data(self.config["data"])
        targets = {config["detector"]["_target_"] for _, config in trials}
        self.detectors: dict[str, Any] = {target: locate(target, "detector._target_") for target in targets}
        self._check(trials)
        self.plan = self._plan(trials)
        self.root = Path(self.config["store"]["root"])
        self.stages_root = self.root / "stages"
        self.store = Store(self.root, self.config["store"]["uri"])

    def _check(self, trials: Trials) -> None:
        """Refuse now what would fail after hours: values that no object takes, tables that cannot be made."""
        for _, config in trials:
            with torch.device("meta"):
                build_optimizer(config, build_detector(config))
        if self.config["sweep"]["tables"]:
            points = [(c["detector"]["_target_"], c["loss"].get("gamma", 0.0), c["seed"]) for _, c in trials]
            keys = {digest(result_config(config)) for _, config in trials}
            if len(set(points)) < len(keys):
                raise ConfigError(
                    f"sweep.tables: Tables {', '.join(self.config['sweep']['tables'])} have one row for each detector "
                    "and gamma (seeds are averaged); these trials differ in something else. Sweep it without +sweep."
                )
        if self.config["selection"]["stages"] not in STAGES:
            raise ConfigError(f"selection.stages: {options(self.config['selection']['stages'], STAGES)}")

    def _plan(self, trials: Trials) -> Plan:
        versions = {"trainer": TRAINER_VERSION} | {t: d.VERSION for t, d in self.detectors.items()}
        offered = {t: d.STAGES for t, d in self.detectors.items()}
        info = DataInfo(self.data.digest, len(self.data.train_ids))
        return make_plan(self.names.experiment, trials, info, versions, offered)

    def run(self, launcher: Launcher) -> Outcome:
        """Train what is missing, score, and write tables.

        Raises:
            StoreError: another process is running a sweep on this store.
            StageFailed: a stage failed; all others are trained and scored.
        """
        with locked(self.root / "lock", wait=False):
            self._freeze()
            recorder = self._recorder()
            try:
                outcome = self._train(launcher, recorder)
            except BaseException:
                recorder.interrupt()
                raise
            recorder.attach(self.report(), "results")
        outcome.check()
        return outcome

    def _train(self, launcher: Launcher, recorder: Recorder) -> Outcome:
        scheduler = self.scheduler(launcher)
        todo = [key for key in self.plan.stages if not scheduler.paths(key).done.exists()]
        self.say(
            f"{self.names.experiment}: {len(self.plan.trials)} trials in {len(self.plan.stages)} stages, "
            f"{self.plan.epochs} epochs (without shared beginnings {self.plan.plain_epochs}); "
            + (f"{len(todo)} stages to train, {launcher.slots} at once" if todo else "everything is done")
        )
        with Progress(self.plan, scheduler.paths) as progress:

            def tick(running: list[Any]) -> None:
                recorder.sync()
                progress.tick(running)

            scheduler.on_tick = tick
            scheduler.on_failure = lambda stage, trace: progress.say(f"\n{stage.key} failed:\n{trace}")
            outcome = scheduler.run()
        recorder.fail({*outcome.failed, *outcome.blocked})
        return outcome

    def scheduler(self, launcher: Launcher) -> Scheduler:
        """What trains the plan's stages; it knows nothing of the store."""
        return Scheduler(self.plan, self.machine(), launcher, self.stages_root)

    def _freeze(self) -> None:
        """Keep the plan, so that tables can be made of these trials later, whatever configs say then."""
        content: Config = {
            "trials": [{"key": t.key, "overrides": list(t.overrides), "stages": t.stages} for t in self.plan.trials]
        }
        content |= {"protocol": self.protocol.id}
        write_text(self.names.plan(self.root), json.dumps(content, indent=1) + "\n")

    def machine(self) -> Config:
        """Settings of this machine, see ``training.run.write_spec``."""
        config = self.config
        return {
            "data_root": str(self.data.root),
            "train_ids": list(self.data.train_ids),
            "val_ids": list(self.data.val_ids),
            "device": config["device"],
            "workers": config["workers"],
            "cache_frames": config["data"]["cache_frames"],
            "save_every_steps": config["schedule"]["save_every_steps"],
            "protocol": config["protocol"],
        }

    def _recorder(self) -> Recorder:
        self.store.open()
        sweep = self.config["sweep"]
        note = f"{sweep['question'] or 'Trials started by hand.'}\n\nFeeds: {', '.join(sweep['tables']) or 'no table'}."
        experiment = self.store.experiment(self.names.experiment, note)
        folder = _folder(self.config, self.data)
        validation = read_validation(folder, self.data.val_ids)
        return Recorder(
            self.store,
            experiment,
            self.plan,
            self.stages_root,
            validation,
            self.protocol,
            self.config["selection"]["stages"],
            {target: detector.NAME for target, detector in self.detectors.items()},
            (self.names.results, self.data.digest),
            self.data.root,
            provenance(),
            _picture(self.stages_root, folder, validation, self.protocol),
        )

    def report(self) -> list[Path]:
        """Write and print the tables of the trials that are done, or, for trials that feed none, their scores.

        Returns:
            every file written.
        """
        done = {t.key for t in self.plan.trials if StagePaths(self.stages_root / t.key).done.exists()}
        written: list[Path] = []
        if not done:
            return written
        if len(done) < len(self.plan.trials):
            self.say(f"\nOnly {len(done)} of {len(self.plan.trials)} trials are done; the others are left out below.")
        scores = stored_scores(self.store, self.names.experiment, done, self.protocol.id)
        if self.config["sweep"]["tables"]:
            written = write_report(self.config, scores, self.say)
        else:
            labels = {t.key: " ".join(t.overrides) for t in self.plan.trials}
            self.say(summary(scores, labels, self.config["selection"]["stages"]))
        self.say("\nTo browse every checkpoint: make ui")
        return written


def _folder(config: Config, data: PreparedData) -> KittiFolder:
    return KittiFolder(data.root, config["data"]["crop"], config["data"]["calibration"])


def _picture(
    stages_root: Path, folder: KittiFolder, validation: Validation, protocol: Protocol
) -> Callable[[Trial, int, Path], list[Path]]:
    """Draws the validation frame with most cars (the first of them)."""
    index = max(range(len(validation.ids)), key=lambda i: ((validation.labels[i].types == "Car").sum(), -i))
    frame = folder.frame(validation.ids[index])

    def draw(trial: Trial, step: int, target: Path) -> list[Path]:
        stored = read_detections(StagePaths(stages_root / trial.key).detections(step))
        rows = stored.frame == index
        found = to_labels(stored.boxes_velo[rows], stored.scores[rows], frame.calibration, frame.image_size, protocol)
        title = f"{' '.join(trial.overrides)}, step {step}, frame {frame.id}"
        return birds_eye(frame, found, protocol.ignore_beyond, title, target / "birds_eye")

    return draw


def run_trials(trials: Trials, launcher: Config) -> None:
    """What the command line starts: a sweep, or a single trial.

    Args:
        trials: overrides and resolved config of each.
        launcher: section of the config, with its ``_target_``.
    """
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    built: Launcher = build(launcher, "hydra.launcher")
    Sweep(trials).run(built)
