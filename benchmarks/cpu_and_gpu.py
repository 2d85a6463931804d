"""What a CUDA device computes beside the CPU: how far apart, whether twice the same, how fast.

    python benchmarks/cpu_and_gpu.py [--device cuda] [--size quick] [--steps 20] [--only fcn3d,voxelnet]

Every detector in every stage of its schedule, sparse and dense where there is a choice, from one set
of weights and on one batch of simulated frames. What is true is computed on the CPU in float64
(sparse): beside it lie the CPU's float32 and the device's. Then the trainer makes some steps on the
CPU, on the device and on the device again, and what the CPU has trained detects on both. With
--steps 0 losses and gradients alone are compared, which full size (--size paper) wants.

Lines come as they are found; the last ones are a table for README.md. --json FILE keeps all numbers.
"""

from __future__ import annotations

import argparse
import copy
import json
import re
import tempfile
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gpu import card, synchronize, timed
from torch import Tensor

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.core.records import Config, Stage
from fl3d.data.dataset import Frames, frames_with
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Batch, Detector, Found
from fl3d.inference.detect import to_device
from fl3d.inference.load import build_detector
from fl3d.inference.reproducibility import prepare
from fl3d.simulator.generate import Settings, write_folder
from fl3d.sweep.setup import prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training.build import build_augmentation, build_optimizer, build_schedule
from fl3d.training.trainer import Trainer

NETWORKS = ("fcn3d", "voxelnet", "pointrcnn", "fconvnet")
WITH_CHOICE = ("fcn3d", "voxelnet")  # of sparse or dense
TRAIN, VAL = 12, 2  # frames
BEST = 100  # boxes of a frame that are compared
NEAR, LIKE = 1e-3, 1e-3  # metres and radians, score: two boxes within both are one
NUDGE = 1e-6  # of every weight: how far such a difference leads in as many steps, the CPU says
UNSTEADY = re.compile(r"^(\S+) does not have a deterministic implementation")


@dataclass(frozen=True)
class Case:
    """A network in a stage, and how it is computed."""

    name: str
    compute: str | None
    stage: Stage
    folder: Path

    @property
    def label(self) -> str:
        """As the table names it."""
        return f"{self.name} {self.stage.name}{f' {self.compute}' if self.compute else ''}"

    @property
    def kitti(self) -> KittiFolder:
        """Its frames."""
        return KittiFolder(self.folder)

    def build(self, compute: str | None = None) -> Detector:
        """The network with its weights, on the CPU."""
        config: Config = copy.deepcopy(self.stage.config)
        if self.compute:
            config["detector"]["compute"] = compute or self.compute
        torch.manual_seed(0)
        return build_detector(config)

    def frames(self, split: str, detector: Detector) -> Frames:
        """Of a split, those that the network learns from."""
        ids = self.kitti.split(split)
        if split == "train" and detector.LEARNS_FROM:
            ids = list(frames_with(self.kitti, ids, detector.LEARNS_FROM))
        return Frames(self.kitti, ids, TRAIN)

    def batch(self, detector: Detector, number: int = 0, training: bool = True) -> Batch:
        """As many frames as a step has."""
        size = self.stage.config["schedule"]["batch_size"]
        frames = self.frames("train", detector)
        some = [frames[(number * size + k) % len(frames)] for k in range(size)]
        rngs = [np.random.default_rng([number, k]) for k in range(size)]
        pairs = zip(some, rngs, strict=True)
        return detector.collate([detector.encode(f, rng, training) for f, rng in pairs])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--size", default="quick", help="profile whose networks are compared")
    parser.add_argument("--steps", type=int, default=20, help="of the trainer; 0: none")
    parser.add_argument("--only", default=",".join(NETWORKS), help="names of networks")
    parser.add_argument("--json", type=Path, help="where all numbers go")
    arguments = parser.parse_args()
    found = {}
    print(f"{card(arguments.device)}, torch {torch.__version__}, profile {arguments.size}")
    with tempfile.TemporaryDirectory() as folder:
        write_folder(Path(folder), Settings(train=TRAIN, val=VAL, seed=0))
        for case in cases(arguments.only.split(","), arguments.size, Path(folder)):
            started = time.monotonic()
            try:
                found[case.label] = measure(case, arguments.device, arguments.steps)
            except Exception as error:  # the others are still to be measured
                found[case.label] = {"failed": f"{type(error).__name__}: {error}"}
            taken = time.monotonic() - started
            print(f"{case.label} ({taken:.0f} s): {json.dumps(found[case.label])}", flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps(found, indent=1))
    print("\n".join(table(found)))
    tell("cpu_and_gpu", {"card": card(arguments.device), **found})


def cases(names: list[str], size: str, folder: Path) -> list[Case]:
    """All stages of all networks, with both ways to compute."""
    found = []
    for name in names:
        for compute in ("sparse", "dense") if name in WITH_CHOICE else (None,):
            own = [f"detector.compute={compute}"] if compute else []
            places = [f"data.root={folder}", "data.generate=false", f"store.root={folder / 'runs'}"]
            config = compose_config(
                [f"detector={name}", f"profile={size}", "loss.gamma=2", *own, *places]
            )
            plan = prepare_sweep(Listed([point_of([], config)])).plan
            stages = [plan.stages[key] for key in plan.trials[0].stages]
            found += [Case(name, compute, stage, folder) for stage in stages]
    return found


def measure(case: Case, device: str, steps: int) -> dict[str, Any]:
    """All that is compared of one case."""
    prepare(0, "cpu")
    truth = one_step(case, "cpu", torch.float64, "sparse")
    found: dict[str, Any] = {
        "cpu": apart(one_step(case, "cpu", torch.float32, "sparse"), truth),
        "device": apart(one_step(case, device, torch.float32), truth),
    }
    if steps:
        cpu, first, again = (trained(case, where, steps) for where in ("cpu", device, device))
        nudged = trained(case, "cpu", steps, nudge=NUDGE)
        start = weights(case.build().state_dict())
        moved = (weights(cpu["model"]) - start).norm()
        found["trained"] = {
            "weights": float((weights(first["model"]) - weights(cpu["model"])).norm() / moved),
            "nudged": float((weights(nudged["model"]) - weights(cpu["model"])).norm() / moved),
            "loss": first["loss"] / cpu["loss"] - 1,
            "same_bits": all(torch.equal(v, again["model"][k]) for k, v in first["model"].items()),
            "again": float((weights(again["model"]) - weights(first["model"])).norm() / moved),
            "unsteady": first["unsteady"],
        }
        found["detected"] = detected(case, cpu["model"], device)
        found["ms"] = {w: round(1e3 * step_seconds(case, w), 2) for w in ("cpu", device)}
        if device != "cpu":
            torch.cuda.reset_peak_memory_stats()
            step_seconds(case, device, 0.1)
            found["megabytes"] = round(torch.cuda.max_memory_allocated() / 1e6)
    return found


def one_step(
    case: Case, device: str, dtype: torch.dtype, compute: str | None = None
) -> tuple[dict[str, float], Tensor]:
    """Loss terms and the gradient, from fresh weights."""
    prepare(0, device)
    detector = case.build(compute).to(device, dtype).train()
    batch = {
        key: value.to(dtype) if torch.is_tensor(value) and value.is_floating_point() else value
        for key, value in case.batch(detector).items()
    }
    torch.manual_seed(1)  # of regions that are drawn
    terms = detector.loss(to_device(batch, device))
    torch.stack(list(terms.values())).sum().backward()
    gradients = [p.grad.flatten() for p in detector.parameters() if p.grad is not None]
    values = {name: float(term.detach()) for name, term in terms.items()}
    return values, torch.cat(gradients).double().cpu()


def apart(
    found: tuple[dict[str, float], Tensor], truth: tuple[dict[str, float], Tensor]
) -> dict[str, float]:
    """Distance of loss terms, over the whole loss, and of gradients, over the gradient's norm."""
    total = sum(map(abs, truth[0].values()))
    terms = max(abs(found[0][name] - value) for name, value in truth[0].items())
    gradient = (found[1] - truth[1]).norm() / truth[1].norm()
    return {"loss": terms / total, "gradient": float(gradient)}


class _EnoughError(Exception):
    """The steps are made."""


def trained(case: Case, device: str, steps: int, nudge: float = 0.0) -> dict[str, Any]:
    """The weights after some steps of the trainer, the mean loss, and operations that may vary."""
    prepare(0, device)
    stage = replace(case.stage, start_step=0, start_epoch=0, epochs=1, epoch_steps=steps)
    detector = case.build()
    state = torch.get_rng_state()  # nudged or not, what is drawn from here on is the same
    with torch.no_grad():
        for parameter in detector.parameters():
            parameter *= 1 + nudge * torch.randn(parameter.shape)
    torch.set_rng_state(state)
    detector.to(device)
    trainer = Trainer(
        stage,
        detector,
        build_optimizer(stage.config, detector),
        build_schedule(stage.config),
        case.frames("train", detector),
        device,
        0,
        build_augmentation(stage.config),
    )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        trainer.train_epoch(lambda: None)
    unsteady = {match[1] for one in said if (match := UNSTEADY.match(str(one.message)))}
    return {
        "model": {key: value.cpu() for key, value in detector.state_dict().items()},
        "loss": trainer.averages.means()["total"],
        "unsteady": sorted(unsteady),
    }


def weights(state: Mapping[str, Tensor]) -> Tensor:
    """All of a network's numbers in a row, but for counters."""
    return torch.cat([v.flatten().double() for v in state.values() if v.is_floating_point()])


def detected(case: Case, state: Mapping[str, Tensor], device: str) -> dict[str, float]:
    """How many of the CPU's best boxes the device finds too, and how far their scores are apart."""
    found: dict[str, list[Found]] = {}
    for where in ("cpu", device):
        prepare(0, where)
        detector = case.build()
        detector.load_state_dict(state)
        detector.to(where).eval()
        batch = to_device(case.batch(detector, 1, training=False), where)
        found[where] = detector.detect(batch, 2 * BEST, 0.0)
    shares, worst = [], 0.0
    for cpu, other in zip(found["cpu"], found[device], strict=True):
        boxes = np.abs(cpu.boxes_velo[:BEST, None] - other.boxes_velo[None])
        boxes[..., 6] = np.minimum(boxes[..., 6], np.abs(2 * np.pi - boxes[..., 6]))
        scores = np.abs(cpu.scores[:BEST, None] - other.scores[None])
        same = (boxes.max(axis=2) < NEAR) & (scores < LIKE)
        shares.append(float(same.any(axis=1).mean()))
        nearest = np.where(same, scores, np.inf).min(axis=1)
        worst = max(worst, float(nearest[np.isfinite(nearest)].max(initial=0.0)))
    return {"shared": float(np.mean(shares)), "scores": worst}


def step_seconds(case: Case, device: str, seconds: float = 1.5) -> float:
    """Of a training step on batches that lie on the device."""
    prepare(0, device)
    detector = case.build().to(device).train()
    optimizer = build_optimizer(case.stage.config, detector)
    batches = [to_device(case.batch(detector, k), device) for k in range(2)]

    def step(batch: Batch) -> None:
        terms = detector.loss(batch)
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()

    synchronize(device)
    return timed(step, batches, device, seconds)


def table(found: Mapping[str, dict[str, Any]]) -> list[str]:
    """For README.md."""
    lines = [
        "| network, stage | loss | gradient | weights trained | boxes shared | same bits | CPU | device | memory |",
        "|---|---|---|---|---|---|---:|---:|---:|",
    ]
    for label, one in found.items():
        if "failed" in one:
            lines.append(f"| {label} | {one['failed']} |")
            continue
        cells = [f"{one['cpu'][k]:.0e}, {one['device'][k]:.0e}" for k in ("loss", "gradient")]
        if "trained" in one:
            ms = list(one["ms"].values())
            trained = one["trained"]
            cells += [f"{trained['nudged']:.0e}, {trained['weights']:.0e}"]
            cells += [f"{one['detected']['shared']:.1%}"]
            cells += ["yes" if trained["same_bits"] else f"no, {trained['again']:.0e}"]
            cells += [f"{ms[0]:.0f} ms", f"{ms[-1]:.1f} ms", f"{one.get('megabytes', 0)} MB"]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return lines


if __name__ == "__main__":
    main()
