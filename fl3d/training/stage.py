"""Run one stage from its folder: what every launcher starts, in whatever process."""

from __future__ import annotations

import contextlib
import time
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.config.modules import make_importable
from fl3d.core.errors import FAULTY, CheckpointError, ConfigError, Fl3dError, Unwritable
from fl3d.core.files import write_text
from fl3d.core.leases import Lease, leased
from fl3d.data.dataset import Frames, frames_with
from fl3d.data.frame_digests import input_digest
from fl3d.detectors.base import WindowDetector
from fl3d.detectors.blocks import as_array
from fl3d.evaluation.detections import write_detections
from fl3d.inference.detect import detect_frames
from fl3d.inference.kept_windows import keep_positives
from fl3d.inference.load import build_detector
from fl3d.inference.reproducibility import prepare
from fl3d.inference.windows import sampled_positives
from fl3d.runs.checkpoints import State, last_state, load_state, save_state
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec, read_spec
from fl3d.training.build import build_augmentation, build_optimizer, build_schedule
from fl3d.training.command import is_command
from fl3d.training.command_run import CommandRun
from fl3d.training.running import StageRun, Timer
from fl3d.training.trainer import Averages, Schedule, Trainer

PROGRESS_SECONDS = 1.0
CUDA_WORKERS = 4  # loader processes of a stage on a GPU, unless told; a CPU has none to spare


def run_stage(folder: Path) -> None:
    """Train a stage to its end, from its last checkpoint if it has one; a finished one is left alone.

    Args:
        folder: of the stage, holding its spec.

    Raises:
        Fl3dError: whatever went wrong; the traceback is left in ``error.txt``.
    """
    run = RunFolder(folder)
    if not run.spec.exists():
        raise ConfigError(f"{run.spec}: no such file; a sweep writes it when it starts the stage")
    try:
        with leased(run.lease) as lease:
            run.error.unlink(missing_ok=True)
            if not run.is_done:
                spec = read_spec(run)
                make_importable(spec.machine.modules)
                kind = CommandRun if is_command(spec.stage.config) else _NetworkRun
                kind(run, lease, spec).run()
    except Exception as error:
        with contextlib.suppress(Unwritable):  # which is why it ended, and is raised
            write_text(run.error, _reason(run, error))
        raise


def _reason(run: RunFolder, error: Exception) -> str:
    """A traceback; of a program, which is not fl3d's code, and of a disk what is wrong is said without one."""
    if isinstance(error, OSError) and (isinstance(error, Unwritable) or error.errno in FAULTY):
        return f"{type(error).__name__}: {error}\n"
    if isinstance(error, Fl3dError) and is_command(read_spec(run).stage.config):
        return f"{type(error).__name__}: {error}\n"
    return traceback.format_exc()


class _NetworkRun(StageRun):
    """A network that is trained in this process."""

    def __init__(self, folder: RunFolder, lease: Lease, spec: Spec) -> None:
        super().__init__(folder, lease, spec)
        self.settings = spec.settings
        self.device = self.machine.device
        prepare(self.settings.seed, self.device, self.settings.precision)
        self.val = Frames(self.kitti, self.machine.val_ids, self.machine.cache_frames)
        self.labels = self.validation()
        self.schedule = self._schedule()
        self.trainer = self._trainer()
        self.timer = Timer()
        self._shown = 0.0
        self._saved = -1  # step of the last whole checkpoint

    def _schedule(self) -> Schedule:
        schedule = build_schedule(self.stage.config, self.machine.save_every_steps)
        return replace(
            schedule, frames_per_epoch=schedule.epoch_frames(len(self.machine.train_ids))
        )

    def _trainer(self) -> Trainer:
        config = self.stage.config
        detector = build_detector(config).to(self.device)
        train_ids = self.machine.train_ids
        types = detector.learns_from()
        if types:
            train_ids = tuple(frames_with(self.kitti, train_ids, types))
        if self.settings.compile:
            detector.compile_dense()
        workers = self.machine.workers
        if workers is None:
            workers = 0 if self.device == "cpu" else CUDA_WORKERS
        return Trainer(
            self.stage,
            detector,
            build_optimizer(config, detector),
            self.schedule,
            Frames(self.kitti, train_ids, self.machine.cache_frames),
            self.device,
            workers,
            build_augmentation(config),
        )

    def run(self) -> None:
        self._restore()
        self._checkpoint_if_due()  # stopped between an epoch's last step and its checkpoint
        while self.trainer.step < self.stage.end_step:
            with self.timer.measure("training"):
                self.trainer.train_epoch(self._after_step)
            self._checkpoint_if_due()
        self._show(force=True)
        self.end(self.trainer.step)
        self.folder.resume.unlink(missing_ok=True)

    def _restore(self) -> None:
        state = self._own_state()
        if state is not None:
            self.trainer.restore(state)
        elif self.stage.parent is not None:
            parent = self.folder.beside(self.stage.parent)
            found = last_state(parent)
            if found is None or found[1].step != self.stage.start_step:
                parent.done.unlink(
                    missing_ok=True
                )  # so that it is trained again, from the checkpoint before
                raise CheckpointError(
                    f"{parent.path}: no whole checkpoint at step {self.stage.start_step}"
                )
            self.trainer.restore(found[0], is_parents=True)
            self.trainer.averages = Averages()

    def _own_state(self) -> State | None:
        found = last_state(self.folder)
        state = found[0] if found else None
        self._saved = found[1].step if found else -1
        if self.folder.resume.exists():
            try:
                resume = load_state(self.folder.resume)
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
            save_state(self.folder.resume, self.trainer.state())

    def _checkpoint_if_due(self) -> None:
        epochs, rest = divmod(self.trainer.step - self.stage.start_step, self.stage.epoch_steps)
        at_end = self.trainer.step == self.stage.end_step
        is_due = (
            rest == 0 and epochs > 0 and (epochs % self.schedule.checkpoint_every == 0 or at_end)
        )
        if is_due and self.trainer.step != self._saved:
            self._checkpoint()
            self._saved = self.trainer.step

    def _checkpoint(self) -> None:
        self.lease.check()
        step = self.trainer.step
        losses = self.trainer.averages.means()
        lr = self.trainer.lr()
        self.trainer.averages = Averages()
        sha256 = save_state(self.folder.weights(step), self.trainer.state())
        with self.timer.measure("detection"):
            self._detect(step, sha256)
        with self.timer.measure("scoring"):
            self.score(step, self.labels)
        seconds = self.timer.take() | {"waiting": round(self.trainer.waited, 3)}
        self.trainer.waited = 0.0
        self.mark(step, self.trainer.epoch, seconds=seconds, lr=lr, losses=losses, sha256=sha256)

    def _detect(self, step: int, sha256: str) -> None:
        """Keep what a checkpoint finds; of the last one its positives too, which a report asks of last models."""
        detector, positives = self.trainer.detector, list[NDArray[np.float32]]()
        is_asked = step == self.stage.end_step and isinstance(detector, WindowDetector)
        found = detect_frames(
            detector,
            self.val,
            self.settings.max_boxes,
            self.settings.min_score,
            self.device,
            self.settings.precision,
            self.schedule.batch_size,
            self.trainer.workers,
            after_batch=lambda: self._show(force=True),
            take_positives=(lambda own: positives.append(as_array(own))) if is_asked else None,
        )
        write_detections(self.folder.detections(step), found)
        if is_asked:
            frames = input_digest(self.kitti, self.machine.val_ids)
            keep_positives(self.folder, step, sha256, frames, sampled_positives(positives))

    def _show(self, force: bool = False) -> None:
        """Renew the progress file; leave when the parent process has gone."""
        now = time.monotonic()
        if force or now - self._shown > PROGRESS_SECONDS:
            self._shown = now
            self.show(self.trainer.step - self.stage.start_step)
