"""Does a detector that has seen simulated frames alone find cars in real KITTI?

    python benchmarks/sim_to_real.py --kitti FOLDER --frames FILE [--seeds 0 1 2]

FOLDER is any KITTI folder (training/{velodyne,label_2,calib}), FILE a list of frame ids, one a
line. VoxelNet and 3D-FCN of profile `quick` (gamma = 0) are trained on the simulator's default
frames and evaluated on the real ones: cars, 3D overlap 0.5, within the profile's range, all others
ignored. Intervals are over frames (bootstrap, 95 %).

Where FOLDER has ImageSets/sample_{train,val}.txt, two more are trained and the three compared on
sample_val: on sample_train alone ("real"), and on sample_train after the simulated frames
("simulated_then_real").

The last line is one JSON object, with under "found": {detector: {"3d_moderate_r40": ..., "ci": [low, high], ...}}.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.core.records import Stage
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.data.splits import read_split
from fl3d.evaluation.bootstrap import resampled_aps, unit_weights
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.scoring import compare_stored
from fl3d.evaluation.validation import read_validation
from fl3d.inference.detect import detect_frames
from fl3d.inference.load import load
from fl3d.runs.layout import StoreFolder
from fl3d.runs.spec import Machine
from fl3d.sweep.launchers.local import LocalLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.run import POLL_SECONDS
from fl3d.sweep.scheduler import Scheduler
from fl3d.sweep.setup import machine, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of

DETECTORS = ("voxelnet", "fcn3d")
LEVELS = ("easy", "moderate", "hard")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True, help="a KITTI folder")
    parser.add_argument(
        "--frames", type=Path, required=True, help="a list of its frame ids, one a line"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0], help="of training; their mean is reported"
    )
    parser.add_argument(
        "--work", type=Path, default=Path("runs/sim_to_real"), help="what is trained is kept here"
    )
    parser.add_argument(
        "--overrides", nargs="*", default=[], help="more Hydra overrides of the simulated trials"
    )
    arguments = parser.parse_args()
    ids = read_split(arguments.frames)
    bench = Bench(
        arguments.kitti.absolute(),
        arguments.work,
        tuple(arguments.seeds),
        tuple(arguments.overrides),
    )
    report = bench.report(ids)
    tell("sim_to_real", report)


@dataclass(frozen=True)
class Trained:
    """A detector that has been trained, by seed."""

    stages: dict[int, Stage]
    plan: Plan


@dataclass(frozen=True)
class Bench:
    """Trains what is missing, and evaluates."""

    kitti: Path
    work: Path
    seeds: tuple[int, ...]
    overrides: tuple[str, ...]

    @property
    def layout(self) -> StoreFolder:
        """Where what is trained lies."""
        return StoreFolder(self.work)

    def report(self, ids: list[str]) -> dict[str, Any]:
        """Train what is missing, and evaluate it on frames."""
        found: dict[str, Any] = {}
        simulated = self.train("simulated", *self.overrides)
        compared = (self.kitti / "ImageSets" / "sample_train.txt").exists()
        if compared:
            real = self.train("real", "data=kitti_sample", f"data.root={self.kitti}")
            both = self.resume(simulated, real)
            sample = KittiFolder(self.kitti).split("sample_val")
        for name in DETECTORS:
            found[name] = self.evaluate(name, simulated[name], ids)
            show(f"{name}, simulated frames alone, {len(ids)} real frames", found[name])
            if not compared:
                continue
            found[name]["sample_val"] = {}
            for title, trained in (
                ("simulated", simulated),
                ("real", real),
                ("simulated_then_real", both),
            ):
                found[name]["sample_val"][title] = self.evaluate(name, trained[name], sample)
                show(f"{name}, {title}, sample_val", found[name]["sample_val"][title])
        return found

    def config(self, detector: str, seed: int, *overrides: str) -> dict[str, Any]:
        """A trial of the bench."""
        own = (
            f"detector={detector}",
            f"seed={seed}",
            "profile=quick",
            "loss.gamma=0",
            f"store.root={self.work}",
        )
        return compose_config([*own, *overrides])

    def train(self, title: str, *overrides: str) -> dict[str, Trained]:
        """Train both detectors on some data: as a sweep does, without its store."""
        print(f"{title}: training", file=sys.stderr, flush=True)
        pairs = [(detector, seed) for detector in DETECTORS for seed in self.seeds]
        points = [
            point_of([f"detector={d}", f"seed={s}"], self.config(d, s, *overrides))
            for d, s in pairs
        ]
        prepared = prepare_sweep(Listed(points))
        plan = prepared.plan
        self.run(plan, machine(prepared))
        trials = dict(zip(pairs, plan.trials, strict=True))
        return {
            d: Trained({s: plan.stages[trials[d, s].key] for s in self.seeds}, plan)
            for d in DETECTORS
        }

    def run(self, plan: Plan, where: Machine) -> None:
        """The loop of a sweep, without sweeper and store."""
        scheduler = Scheduler(where, LocalLauncher(), self.layout)
        try:
            while True:
                scheduler.step(plan)
                if scheduler.is_idle(plan):
                    break
                time.sleep(POLL_SECONDS)
        finally:
            scheduler.close()
        scheduler.outcome.check()

    def resume(self, simulated: dict[str, Trained], real: dict[str, Trained]) -> dict[str, Trained]:
        """The last stage of the real trials once more, from the simulated trials' end."""
        print("simulated_then_real: training", file=sys.stderr, flush=True)
        stages: dict[str, Stage] = {}
        for d in DETECTORS:
            for s in self.seeds:
                stages[f"{d}{s}"] = resumed(simulated[d].stages[s], real[d].stages[s])
        config = self.config(DETECTORS[0], 0, "data=kitti_sample", f"data.root={self.kitti}")
        where = machine(prepare_sweep(Listed([point_of([], config)])))
        before = simulated[DETECTORS[0]].plan.stages
        after = {stage.key: stage for stage in stages.values()}
        plan = Plan("simulated_then_real", (), {**before, **after})
        self.run(plan, where)
        return {d: Trained({s: stages[f"{d}{s}"] for s in self.seeds}, plan) for d in DETECTORS}

    def evaluate(self, detector: str, trained: Trained, ids: list[str]) -> dict[str, Any]:
        """AP on real frames: mean over the seeds, and the interval of that mean over frames."""
        config = self.config(detector, 0)
        folder = KittiFolder(self.kitti, config["data"]["crop"], config["data"]["calibration"])
        validation = read_validation(folder, ids)
        protocol = Protocol(**config["protocol"])
        weights = unit_weights(len(ids), 1000, 0)
        once = np.ones((1, len(ids)), dtype=np.int64)
        values: dict[str, list[np.ndarray]] = {}
        resampled = []
        for seed in self.seeds:
            stage = trained.stages[seed]
            network = load(self.layout.run(stage.key), stage.end_step)
            limits = config["detections"]
            frames = Frames(folder, ids, 0)
            boxes = detect_frames(network, frames, limits["max_boxes"], limits["min_score"])
            comparison = compare_stored(boxes, validation, protocol)
            for level in LEVELS:
                values.setdefault(level, []).append(
                    resampled_aps(comparison.matches("Car", "3d", level), once)[0]
                )
            resampled.append(
                resampled_aps(comparison.matches("Car", "3d", "moderate"), weights)[:, 1]
            )
        low, high = np.percentile(np.mean(resampled, axis=0), [2.5, 97.5])
        result: dict[str, Any] = {}
        for level in LEVELS:
            for column, average in enumerate(("r11", "r40")):
                result[f"3d_{level}_{average}"] = round(
                    float(np.mean([v[column] for v in values[level]])), 2
                )
        result["ci"] = [round(float(low), 2), round(float(high), 2)]
        result["by_seed"] = [round(float(v[1]), 2) for v in values["moderate"]]
        return {
            **result,
            "frames": len(ids),
            "cars": int(comparison.matches("Car", "3d", "hard").n_gt.sum()),
        }


def resumed(parent: Stage, own: Stage) -> Stage:
    """A stage once more, from the end of another."""
    return Stage(
        key=f"{parent.key}-then-{own.key.rsplit('-', 1)[-1]}",
        name=own.name,
        config=own.config,
        parent=parent.key,
        start_epoch=parent.start_epoch + parent.epochs,
        start_step=parent.end_step,
        epochs=own.epochs,
        epoch_steps=own.epoch_steps,
    )


def show(title: str, found: dict[str, Any]) -> None:
    low, high = found["ci"]
    levels = " / ".join(f"{found[f'3d_{level}_r40']:.1f}" for level in LEVELS)
    seeds = ", ".join(f"{value:.1f}" for value in found["by_seed"])
    print(
        f"{title}: 3D AP R40 {levels}, moderate [{low:.1f}, {high:.1f}], by seed {seeds}",
        flush=True,
    )


if __name__ == "__main__":
    main()
