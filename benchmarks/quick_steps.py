"""A step and a detection of profile quick, VoxelNet and 3D-FCN, beside those of another checkout.

    python benchmarks/quick_steps.py --simulated FOLDER [--against CHECKOUT] [--rounds 40]

CPU milliseconds on one thread of two frames at once, as the profile trains: a step (loss, backward,
clipping, optimiser), a detection, encoding with targets, and collation with rulebooks. Each
checkout has one process, and they take turns, a batch each, so that whatever else the machine does
meets both alike. Shown are medians and, in brackets, the least; the last line is one JSON object of
the ratios of medians.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import numpy as np
import torch

from fl3d.config.compose import compose_config
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.detectors.base import Batch, Sample
from fl3d.inference.load import build_detector
from fl3d.inference.reproducibility import prepare
from fl3d.training.build import build_optimizer

HERE = Path(__file__).resolve().parent.parent
NETWORKS = ("voxelnet", "fcn3d")
FRAMES, WARM_UP = 20, 3


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--simulated", type=Path, required=True)
    parser.add_argument("--against", type=Path, help="another checkout of fl3d")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        serve(arguments.simulated)
        return
    places = {"here": HERE} | ({"there": arguments.against} if arguments.against else {})
    processes = {name: start(place, arguments.simulated) for name, place in places.items()}
    seen: dict[str, list[dict[str, float]]] = {name: [] for name in places}
    for _ in range(arguments.rounds + WARM_UP):
        for name, process in processes.items():
            seen[name].append(ask(process))
    for process in processes.values():
        process.terminate()
    ratios = {}
    for part in seen["here"][0]:
        times = {name: [found[part] for found in all_[WARM_UP:]] for name, all_ in seen.items()}
        shown = (f"{name} {median(own):7.2f} ({min(own):7.2f})" for name, own in times.items())
        print(f"{part:22s}", ", ".join(shown))
        if "there" in times:
            ratios[part] = round(median(times["here"]) / median(times["there"]), 2)
    from benchmarks.told import tell  # not above: the process of an older checkout may not have it

    tell("quick_steps", {"ratios": ratios} | {name: medians(all_) for name, all_ in seen.items()})


def medians(rounds: list[dict[str, float]]) -> dict[str, float]:
    """CPU milliseconds of each part."""
    counted = rounds[WARM_UP:]
    return {part: median(found[part] for found in counted) for part in counted[0]}


def start(checkout: Path, simulated: Path) -> subprocess.Popen[str]:
    """A process of a checkout that measures a round whenever it is asked."""
    command = [sys.executable, __file__, "--simulated", str(simulated), "--one"]
    environment = {**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)


def ask(process: subprocess.Popen[str]) -> dict[str, float]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    found: dict[str, float] = json.loads(process.stdout.readline())
    return found


def serve(simulated: Path) -> None:
    """Answer each line with a round's milliseconds."""
    rounds = [measured(name, simulated) for name in NETWORKS]
    for _ in sys.stdin:
        print(
            json.dumps({k: v for network in rounds for k, v in next(network).items()}), flush=True
        )


def measured(name: str, simulated: Path) -> Iterator[dict[str, float]]:
    """Milliseconds of each part, batch after batch."""
    prepare(0, "cpu")
    config = compose_config([f"detector={name}", "profile=quick"])
    detector = build_detector(config)
    optimizer = build_optimizer(config, detector)
    folder = KittiFolder(simulated)
    frames = [folder.frame(i) for i in folder.split("train")[:FRAMES]]

    def encode(two: list[Frame]) -> list[Sample]:
        return [detector.encode(f, np.random.default_rng(0), training=True) for f in two]

    def step(batch: Batch) -> None:
        optimizer.zero_grad()
        torch.stack(list(detector.loss(batch).values())).sum().backward()
        torch.nn.utils.clip_grad_norm_(detector.parameters(), 10.0)
        optimizer.step()

    while True:
        for start in range(0, FRAMES, 2):
            two = frames[start : start + 2]
            samples = encode(two)
            batch = detector.collate(samples)
            detector.train()
            found = {f"{name} step": milliseconds(step, batch)}
            detector.eval()
            found[f"{name} detection"] = milliseconds(detector.detect, batch, 300, 0.01)
            found[f"{name} encoding"] = milliseconds(encode, two)
            found[f"{name} collation"] = milliseconds(detector.collate, samples)
            yield found


def milliseconds(run: Callable[..., object], *arguments: object) -> float:
    started = time.process_time()
    run(*arguments)
    return 1e3 * (time.process_time() - started)


if __name__ == "__main__":
    main()
