"""Run one stage from its folder: what every launcher starts, in whatever process."""

from __future__ import annotations

import json
import multiprocessing as mp
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

from fl3d.data.dataset import Frames, frames_with
from fl3d.data.kitti import KittiFolder
from fl3d.digests import file_digest
from fl3d.errors import CheckpointError, ConfigError, Fl3dError
from fl3d.evaluation.detections import Detections, Validation, read_detections, read_validation, score, write_detections
from fl3d.evaluation.protocol import Protocol
from fl3d.files import write_text
from fl3d.leases import Lease, leased
from fl3d.records import Checkpoint, Config, Stage, StagePaths
from fl3d.training.build import build_augmentation, build_detector, build_optimizer, build_protocol, build_schedule
from fl3d.training.checkpoints import State, last_state, load_state, read_marker, save_state, write_marker
from fl3d.training.reproducibility import prepare
from fl3d.training.trainer import Averages, Trainer, detect_frames

PROGRESS_SECONDS = 1.0
CUDA_WORKERS = 4  # loader processes of a stage on a GPU, unless told; a CPU has none to spare


def write_spec(paths: StagePaths, stage: Stage, machine: Config) -> None:
    """Freeze a stage in its folder, with the settings of this machine that do not change a result.

    Args:
        paths: of the stage.
        stage: what is trained.
        machine: ``data_root``, ``train_ids``, ``val_ids``, ``device``, ``workers``, ``cache_frames``,
            ``save_every_steps``, ``protocol``, ``provenance``.
    """
    write_text(paths.spec, json.dumps({"stage": asdict(stage), "machine": machine}, indent=1) + "\n")


def run_stage(folder: Path) -> None:
    """Train a stage to its end, from its last checkpoint if it has one; a finished one is left alone.

    Args:
        folder: of the stage, holding its spec.

    Raises:
        Fl3dError: whatever went wrong; the traceback is left in ``error.txt``.
    """
    paths = StagePaths(folder)
    if not paths.spec.exists():
        raise ConfigError(f"{paths.spec}: no such file; a sweep writes it when it starts the stage")
    try:
        with leased(paths.lease) as lease:
            paths.error.unlink(missing_ok=True)
            if not paths.done.exists():
                _Run(paths, lease).run()
    except Exception:
        write_text(paths.error, traceback.format_exc())
        raise


class _Run:
    """A stage on this machine."""

    def __init__(self, paths: StagePaths, lease: Lease) -> None:
        self._started, self._cpu = time.time(), time.process_time()
        spec = json.loads(paths.spec.read_text())
        self.lease = lease
        self.paths, self.stage, self.machine = paths, Stage(**spec["stage"]), spec["machine"]
        config = self.stage.config
        self.device: str = self.machine["device"]
        prepare(config["seed"], self.device, config["precision"])
        folder = KittiFolder(Path(self.machine["data_root"]), config["data"]["crop"], config["data"]["calibration"])
        cache: int = self.machine["cache_frames"]
        self.val = Frames(folder, self.machine["val_ids"], cache)
        self.validation = read_validation(folder, self.val.ids)
        self.protocol = build_protocol(self.machine["protocol"])
        self.detector = build_detector(config).to(self.device)
        train_ids = self.machine["train_ids"]
        schedule = build_schedule(config, self.machine)
        self.schedule = replace(schedule, frames_per_epoch=schedule.epoch_frames(len(train_ids)))
        if self.detector.LEARNS_FROM:
            train_ids = frames_with(folder, train_ids, self.detector.LEARNS_FROM)
        self.train = Frames(folder, train_ids, cache)
        if config["compile"]:
            self.detector.compile_dense()
        optimizer = build_optimizer(config, self.detector)
        workers = self.machine["workers"]
        if workers is None:
            workers = 0 if self.device == "cpu" else CUDA_WORKERS
        self.trainer = Trainer(
            self.stage,
            self.detector,
            optimizer,
            self.schedule,
            self.train,
            self.device,
            workers,
            build_augmentation(config),
        )
        self.timer = _Timer()
        self._shown = 0.0
        self._saved = -1  # step of the last whole checkpoint
        parent = mp.parent_process()
        self._parent = parent if parent is not None and parent.sentinel is not None else None  # joblib's has none

    def run(self) -> None:
        self._restore()
        self._checkpoint_if_due()  # stopped between an epoch's last step and its checkpoint
        while self.trainer.step < self.stage.end_step:
            with self.timer.measure("training"):
                self.trainer.train_epoch(self._after_step)
            self._checkpoint_if_due()
        self._show(force=True)
        self.lease.check()
        ended = {"step": self.trainer.step, "started": self._started, "ended": time.time()}
        ended["cpu_seconds"] = round(time.process_time() - self._cpu, 3)  # of the last process that trained it
        write_text(self.paths.done, json.dumps(ended) + "\n")
        self.paths.resume.unlink(missing_ok=True)

    def _restore(self) -> None:
        state = self._own_state()
        if state is not None:
            self.trainer.restore(state)
        elif self.stage.parent is not None:
            parent = StagePaths(self.paths.folder.parent / self.stage.parent)
            found = last_state(parent)
            if found is None or found[1].step != self.stage.start_step:
                parent.done.unlink(missing_ok=True)  # so that it is trained again, from the checkpoint before
                raise CheckpointError(f"{parent.folder}: no whole checkpoint at step {self.stage.start_step}")
            self.trainer.restore(found[0], is_parents=True)
            self.trainer.averages = Averages()

    def _own_state(self) -> State | None:
        found = last_state(self.paths)
        state = found[0] if found else None
        self._saved = found[1].step if found else -1
        if self.paths.resume.exists():
            try:
                resume = load_state(self.paths.resume)
            except CheckpointError:
                return state
            if state is None or resume["step"] > state["step"]:
                return resume
        return state

    def _after_step(self) -> None:
        self._show()
        every = self.schedule.save_every_steps
        if every and self.trainer.step % every == 0:
            self.lease.check()
            save_state(self.paths.resume, self.trainer.state())

    def _checkpoint_if_due(self) -> None:
        epochs, rest = divmod(self.trainer.step - self.stage.start_step, self.stage.epoch_steps)
        at_end = self.trainer.step == self.stage.end_step
        is_due = rest == 0 and epochs > 0 and (epochs % self.schedule.checkpoint_every == 0 or at_end)
        if is_due and self.trainer.step != self._saved:
            self._checkpoint()
            self._saved = self.trainer.step

    def _checkpoint(self) -> None:
        self.lease.check()
        step, losses, lr = self.trainer.step, self.trainer.averages.means(), self.trainer.lr()
        self.trainer.averages = Averages()
        sha256 = save_state(self.paths.weights(step), self.trainer.state())
        with self.timer.measure("detection"):
            limits = self.stage.config["detections"]
            found = detect_frames(
                self.detector,
                self.val,
                limits["max_boxes"],
                limits["min_score"],
                self.device,
                self.stage.config["precision"],
                self.schedule.batch_size,
                self.trainer.workers,
                after_batch=lambda: self._show(force=True),
            )
            write_detections(self.paths.detections(step), found)
        with self.timer.measure("scoring"):
            write_scores(self.paths, step, self.validation, self.protocol)
        seconds = self.timer.take() | {"waiting": round(self.trainer.waited, 3)}
        self.trainer.waited = 0.0
        found_sha256 = file_digest(self.paths.detections(step))
        made = self.machine.get("provenance", {})
        self.lease.check()
        write_marker(
            self.paths,
            Checkpoint(
                self.stage.key,
                step,
                self.trainer.epoch,
                lr,
                losses,
                seconds,
                sha256,
                found_sha256,
                _first_made(self.paths, step),
                made,
            ),
        )

    def _show(self, force: bool = False) -> None:
        """Renew the progress file; leave when the parent process has gone."""
        now = time.monotonic()
        if force or now - self._shown > PROGRESS_SECONDS:
            self._shown = now
            done = self.trainer.step - self.stage.start_step
            write_text(self.paths.progress, json.dumps({"step": done, "steps": self.stage.steps}))
            if self._parent is not None and not self._parent.is_alive():
                raise Fl3dError("the process that started this stage has ended; run the same command to go on")


def detect_again(paths: StagePaths, step: int) -> Detections:
    """What a checkpoint's weights predict on the validation frames now.

    Raises:
        CheckpointError: the weights cannot be read.
    """
    spec = json.loads(paths.spec.read_text())
    stage, machine = Stage(**spec["stage"]), spec["machine"]
    device, precision = machine["device"], stage.config.get("precision", "float32")
    prepare(stage.config["seed"], device, precision)
    data, limits = stage.config["data"], stage.config["detections"]
    frames = Frames(KittiFolder(Path(machine["data_root"]), data["crop"], data["calibration"]), machine["val_ids"], 0)
    detector = build_detector(stage.config).to(device)
    detector.load_state_dict(load_state(paths.weights(step))["model"])
    size = stage.config["schedule"]["batch_size"]  # rounding differs with it
    return detect_frames(detector, frames, limits["max_boxes"], limits["min_score"], device, precision, size)


def write_scores(paths: StagePaths, step: int, validation: Validation, protocol: Protocol) -> None:
    """Score a checkpoint's stored detections, unless that is done."""
    path = paths.scores(step, protocol.id)
    if not path.exists():
        scores = score(read_detections(paths.detections(step)), validation, protocol)
        write_text(path, json.dumps(scores, indent=1) + "\n")


def _first_made(paths: StagePaths, step: int) -> int:
    """Milliseconds since 1970 at which a checkpoint was first made: made again, it keeps its place in the store."""
    if paths.marker(step).exists():
        return read_marker(paths, step).time_ms
    return int(time.time() * 1000)


class _Timer:
    """Seconds by purpose, since they were last taken."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self._seconds[name] = self._seconds.get(name, 0.0) + time.perf_counter() - started

    def take(self) -> dict[str, float]:
        seconds, self._seconds = self._seconds, {}
        return {name: round(value, 3) for name, value in seconds.items()}
