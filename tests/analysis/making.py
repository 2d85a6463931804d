"""Finished sweeps with run folders and no training: detections are the labels, moved about."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.samples import Comparisons, Samples, resample
from fl3d.core.records import Checkpoint, Stage, Trial
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.bootstrap import N_RESAMPLES
from fl3d.evaluation.detections import Detections, read_detections, write_detections
from fl3d.evaluation.scoring import score
from fl3d.evaluation.validation import read_validation
from fl3d.runs.checkpoints import write_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder
from fl3d.runs.scores import tidy
from fl3d.runs.spec import Spec, read_spec, write_done, write_spec
from fl3d.runs.trials import FinishedTrial
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.sweep.setup import Prepared, machine
from tests.support import small_sweep

Noise = Callable[[Trial], float]


def detected_sweep(
    simulated: Path, root: Path, points: Sequence[Sequence[str]], noise: Noise, *words: str
) -> FinishedSweep:
    """A sweep each of whose trials has found the cars at its last step, as far off as a test wants.

    Args:
        simulated: a KITTI folder.
        root: below which its store lies.
        points: its trials.
        noise: how far off the boxes of a trial are, metres.
        words: what all trials share.
    """
    prepared = small_sweep(simulated, root, points, *words)
    validation = read_validation(prepared.kitti, prepared.data.val_ids)
    raw = []
    for trial in prepared.plan.trials:
        for key in trial.stages:
            stage = prepared.plan.stages[key]
            _write_stage(prepared, stage)
            folder = prepared.layout.run(key)
            off = noise(trial) if key == trial.key else 1.0
            ids = prepared.data.val_ids
            found = found_cars(prepared.kitti, ids, off, trial.seed)
            write_detections(folder.detections(stage.end_step), found)
            scores = score(
                read_detections(folder.detections(stage.end_step)),
                validation,
                prepared.settings.protocol,
            )
            front = {
                "run": trial.key,
                "trial": trial.key,
                "protocol": prepared.settings.protocol.id,
            }
            raw.append(
                {
                    **front,
                    "step": stage.end_step,
                    "epoch": stage.start_epoch + stage.epochs,
                    **scores,
                }
            )
    plan = prepared.planner.frozen(prepared.plan)
    trials = [
        FinishedTrial(one, tuple(prepared.layout.run(key) for key in one.stages))
        for one in plan.trials
    ]
    return FinishedSweep(
        settings=prepared.settings,
        plan=plan,
        trials=tuple(trials),
        scores=tidy(pd.DataFrame(raw), list(plan.trials), prepared.settings.protocol),
        source=root,
    )


def without(sweep: FinishedSweep, is_missing: Callable[[FinishedTrial], bool]) -> FinishedSweep:
    """A sweep some of whose trials are not done."""
    trials = tuple(trial for trial in sweep.trials if not is_missing(trial))
    scores = sweep.scores[sweep.scores["trial"].isin([trial.key for trial in trials])]
    return replace(sweep, trials=trials, scores=scores.reset_index(drop=True))


class Finding(Launcher):
    """Trains nothing: each stage finds the labels' cars at once, as far off as a test wants.

    Args:
        noise: how far off the boxes of a stage are, metres; an exception is raised in its stead.
        seconds: that each stage says it took.
    """

    slots = 2

    def __init__(self, noise: Callable[[Stage], float], seconds: float = 60.0) -> None:
        self.noise = noise
        self.seconds = seconds
        self.launched: list[str] = []

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Write what a stage would have written, or that it failed."""
        run = RunFolder(folder)
        spec = read_spec(run)
        self.launched.append(run.key)
        try:
            off = self.noise(spec.stage)
        except ValueError:
            return Ended(JobState.RAISED)
        stage = spec.stage
        found = found_cars(spec.kitti(), spec.machine.val_ids, off, spec.settings.seed)
        for epoch in range(1, stage.epochs + 1):
            write_detections(run.detections(stage.start_step + epoch * stage.epoch_steps), found)
            _write_epoch(run, stage, epoch, self.seconds / stage.epochs)
        write_done(run, {})
        return Ended(JobState.DONE)


class Ended(Job):
    """A stage that has ended.

    Args:
        state: how.
    """

    def __init__(self, state: JobState) -> None:
        self._state = state

    def state(self) -> JobState:
        """How it ended."""
        return self._state

    def cancel(self) -> None:
        """Nothing runs."""


def _write_stage(prepared: Prepared, stage: Stage) -> None:
    folder = prepared.layout.run(stage.key)
    write_spec(folder, Spec(stage, machine(prepared)))
    _write_epoch(folder, stage, stage.epochs, 0.0)
    write_done(folder, {})


def _write_epoch(folder: RunFolder, stage: Stage, epoch: int, seconds: float) -> None:
    purposes = {"training": seconds, "detection": 0.0, "scoring": 0.0} if seconds else {}
    checkpoint = Checkpoint(
        stage=stage.key,
        step=stage.start_step + epoch * stage.epoch_steps,
        epoch=stage.start_epoch + epoch,
        lr=0.1,
        losses={},
        seconds=purposes,
        sha256="",
    )
    write_marker(folder, checkpoint)


def found_cars(kitti: KittiFolder, ids: tuple[str, ...], noise: float, seed: int) -> Detections:
    """Boxes of the labels, moved along by so much noise; others for another seed."""
    rng = np.random.default_rng(seed)
    frames = []
    boxes = []
    for place, frame_id in enumerate(ids):
        calibration = kitti.read_calibration(frame_id)
        labels = kitti.read_labels(frame_id)
        own = calibration.boxes_to_velo(labels.boxes_cam[labels.types == "Car"])
        boxes.append(own + rng.normal(0, noise, (len(own), 1)) * [1, 0, 0, 0, 0, 0, 0])
        frames.append(np.full(len(own), place))
    found = np.concatenate(boxes)
    return Detections(ids, np.concatenate(frames), found, rng.uniform(0.9, 1.0, len(found)))


def resample_sweep(
    compared: Comparisons, units: NDArray[np.int64] | None = None, n_resamples: int = N_RESAMPLES
) -> Samples:
    """APs of all checkpoints in the same resamples of the frames, made here and now."""
    return {
        group: {
            level: {seed: resample(one, units, n_resamples) for seed, one in by_seed.items()}
            for level, by_seed in levels.items()
        }
        for group, levels in compared.items()
    }
