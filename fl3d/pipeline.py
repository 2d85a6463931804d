"""Run a sweep from what a sweeper proposes to tables."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Callable
from pathlib import Path

from fl3d.config import build
from fl3d.data.kitti import KittiFolder
from fl3d.data.prepare import prepare_data
from fl3d.errors import ConfigError, StoreError
from fl3d.evaluation.detections import Validation, read_detections, read_validation, to_labels
from fl3d.evaluation.protocol import Protocol
from fl3d.files import write_text
from fl3d.leases import Lease, holder_of, leased
from fl3d.provenance import provenance, uncommitted
from fl3d.records import Config, StagePaths, Trial
from fl3d.reports.figures.boxes import birds_eye
from fl3d.results import names, results_folder, stored_scores, summary, write_report
from fl3d.store.tracking import Store
from fl3d.sweep.conductor import Conductor
from fl3d.sweep.cost import Costs
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.plan import DataInfo
from fl3d.sweep.planner import Planner
from fl3d.sweep.progress import Progress
from fl3d.sweep.recorder import Recorder
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.sweepers.base import Sweeper


class Sweep:
    """A sweep on this machine.

    Args:
        sweeper: proposes its trials.
        say: prints a line for the user.

    Raises:
        ConfigError: there are no trials, or they cannot be run or tabulated.
        DataError: the data cannot be used.
    """

    def __init__(self, sweeper: Sweeper, say: Callable[[str], None] = print) -> None:
        self.sweeper, self.config, self.say = sweeper, sweeper.base, say
        if not self.config:
            raise ConfigError("a sweep needs at least one trial")
        self.names = names(self.config)
        self.protocol = Protocol(**self.config["protocol"])
        self.root = Path(self.config["store"]["root"])
        self.stages_root = self.root / "stages"
        self.store = Store(self.root, self.config["store"]["uri"])
        self.data = prepare_data(self.config["data"])
        self.planner = Planner(
            self.config, DataInfo(self.data.digest, len(self.data.train_ids), self.data.image_digest)
        )
        self.plan = self.planner.plan(sweeper.first())
        self.provenance = provenance()

    def run(self, launcher: Launcher) -> Outcome:
        """Train what is missing, score, and write tables.

        Raises:
            StoreError: another process is running this sweep on this store, or the store cannot be reached.
            StageFailed: a stage failed; all others are trained and scored.
        """
        launcher.open()
        with leased(self.names.plan(self.root).with_suffix(".lease"), wait=False) as lease:
            self._refuse_several_machines()
            self.store.open()
            if self.plan.trials:
                self._freeze()
            scores = self._scoreboard()
            recorder = self._recorder(scores)
            try:
                outcome, told = self._train(launcher, recorder, scores, lease)
            except BaseException:
                recorder.interrupt()
                raise
            written = [path for path in self.report(told) if path.parent.name != "scores"]  # MLflow holds them
            recorder.attach(written, "results")
        outcome.check()
        return outcome

    def _refuse_several_machines(self) -> None:
        """SQLite's journal lies in one machine's memory: two that write to it over a shared folder destroy it.

        Raises:
            StoreError: another machine runs a sweep on this root.
        """
        for path in (self.root / "plans").glob("*.lease") if self.store.is_file else ():
            holder = holder_of(path)
            if holder is not None and holder.host != socket.gethostname():
                raise StoreError(
                    f"{path}: {holder} runs a sweep on this store, and SQLite is for one machine at a time; "
                    "give both a server: store.uri=postgresql://USER@HOST/NAME or http://HOST:PORT"
                )

    def _train(self, launcher: Launcher, recorder: Recorder, scores: Scoreboard, lease: Lease) -> tuple[Outcome, str]:
        costs = Costs(self.stages_root, len(self.data.val_ids))
        scheduler = self.scheduler(launcher)
        scheduler.seconds = lambda stage: costs.cost(stage).seconds
        self.sweeper.open(self.planner.key)
        self._announce(launcher)

        def grown() -> None:
            self.plan = scheduler.plan
            recorder.names = self.planner.detector_names()
            self._freeze()

        with Progress(self.plan, scheduler.paths, costs, launcher.slots) as progress:
            recorder.say = progress.say
            every = self.config["store"]["keep_every"]
            conductor = Conductor(
                self.sweeper, self.planner, scheduler, recorder, scores, progress, grown, every, lease.check
            )
            outcome = conductor.run()
        return outcome, self.sweeper.report(conductor.standings(), results_folder(self.config))

    def _announce(self, launcher: Launcher) -> None:
        if not self.plan.trials:
            self.say(f"{self.names.experiment}: trials are proposed one by one, {launcher.slots} stages at once")
            return
        todo = [key for key in self.plan.stages if not StagePaths(self.stages_root / key).done.exists()]
        self.say(
            f"{self.names.experiment}: {len(self.plan.trials)} trials in {len(self.plan.stages)} stages, "
            f"{self.plan.epochs} epochs (without shared beginnings {self.plan.plain_epochs}); "
            + (f"{len(todo)} stages to train, {launcher.slots} at once" if todo else "everything is done")
        )

    def scheduler(self, launcher: Launcher) -> Scheduler:
        """What trains the plan's stages; it knows nothing of the store."""
        return Scheduler(self.plan, self.machine(), launcher, self.stages_root)

    def _freeze(self) -> None:
        """Keep the plan, so that tables can be made of these trials later, whatever configs say then.

        Trials of earlier starts under the same name are remembered too: their stages are nobody's waste.
        """
        path = self.names.plan(self.root)
        trials = [{"key": t.key, "overrides": list(t.overrides), "stages": t.stages} for t in self.plan.trials]
        before = json.loads(path.read_text()) if path.exists() else {"trials": []}
        now = {trial.key for trial in self.plan.trials}
        earlier = {one["key"]: one for one in [*before.get("earlier", []), *before["trials"]] if one["key"] not in now}
        write_text(path, json.dumps({"trials": trials, "earlier": list(earlier.values())}, indent=1) + "\n")

    def machine(self) -> Config:
        """Settings of this machine, see ``training.run.write_spec``."""
        config = self.config
        return {
            "data_root": str(self.data.root.absolute()),
            "train_ids": list(self.data.train_ids),
            "val_ids": list(self.data.val_ids),
            "device": config["device"],
            "workers": config["workers"],
            "cache_frames": config["data"]["cache_frames"],
            "save_every_steps": config["schedule"]["save_every_steps"],
            "protocol": config["protocol"],
            "keep_every": config["store"]["keep_every"],
            "provenance": self.provenance,
        }

    def _folder(self) -> KittiFolder:
        return KittiFolder(self.data.root, self.config["data"]["crop"], self.config["data"]["calibration"])

    def _scoreboard(self) -> Scoreboard:
        return Scoreboard(self.stages_root, read_validation(self._folder(), self.data.val_ids), self.protocol)

    def _note(self) -> str:
        """What MLflow shows above the experiment's runs, as Markdown."""
        sweep = self.config["sweep"]
        data, profile = self.config["data"]["name"], self.config["profile"]["name"]
        feeds = ", ".join(f"Table {number}" for number in sweep["tables"]) or "no table of the paper"
        target = f"`make sweep-{sweep['name']} DATA={data} PROFILE={profile}`" if sweep["tables"] else "started by hand"
        return (
            f"**{sweep['question'] or 'Trials started by hand.'}** Feeds {feeds}.\n\n"
            f"Command: {target}; then `make report DATA={data} PROFILE={profile}`. One run is one trial; "
            f"`ap_3d/moderate` over steps is its curve; the models *last* and *best* are what the tables show. "
            f"Protocol {self.protocol.id}."
        )

    def _recorder(self, scores: Scoreboard) -> Recorder:
        changes = uncommitted() if "fl3d.diff" in self.provenance else ""
        return Recorder(
            self.store,
            self.store.experiment(self.names.experiment, self._note()),
            scores,
            self.config["selection"]["stages"],
            self.planner.detector_names(),
            (self.names.results, self.data.digest),
            self.data.root,
            {**self.provenance, "fl3d.evaluator": scores.protocol.id},
            {"uncommitted.patch": changes} if changes else {},
            _picture(self.stages_root, self._folder(), scores.validation, self.protocol),
        )

    def report(self, told: str = "") -> list[Path]:
        """Write and print the tables of the trials that are done, or, for trials that feed none, their scores.

        Args:
            told: what the sweeper itself has found.

        Returns:
            every file written.
        """
        done = {t.key for t in self.plan.trials if StagePaths(self.stages_root / t.key).done.exists()}
        written: list[Path] = []
        if not done:
            return written
        if len(done) < len(self.plan.trials):
            self.say(f"\n{len(done)} of {len(self.plan.trials)} trials are done; the others are left out below.")
        scores = stored_scores(self.store, self.names.experiment, done, self.protocol.id)
        if self.config["sweep"]["tables"]:
            _, written = write_report(self.config, scores, self.say)
        else:
            labels = {t.key: " ".join(t.overrides) for t in self.plan.trials}
            self.say(summary(scores, labels, self.config["selection"]["stages"]))
        if told:
            self.say(told)
        self.say("\nTo browse every checkpoint: make ui")
        return written


def _picture(
    stages_root: Path, folder: KittiFolder, validation: Validation, protocol: Protocol
) -> Callable[[Trial, int, Path], list[Path]]:
    """Draws the validation frame with most cars (the first of them)."""
    index = max(range(len(validation.ids)), key=lambda i: ((validation.labels[i].types == "Car").sum(), -i))
    frame = folder.frame(validation.ids[index])

    def draw(trial: Trial, step: int, target: Path) -> list[Path]:
        stored = read_detections(StagePaths(stages_root / trial.key).detections(step))
        found = to_labels(*stored.of(index), frame.calibration, frame.image_size, protocol)
        title = f"{' '.join(trial.overrides)}, step {step}, frame {frame.id}"
        return birds_eye(frame, found, protocol.ignore_beyond, title, target / "birds_eye")

    return draw


def run_sweep(sweeper: Sweeper, launcher: Config) -> None:
    """What the command line starts: a sweep, or a single trial.

    Args:
        sweeper: proposes its trials.
        launcher: section of the config, with its ``_target_``.
    """
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    built: Launcher = build(launcher, "hydra.launcher")
    built.open()
    Sweep(sweeper).run(built)
