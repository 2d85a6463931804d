"""What a GPU makes of the paper's networks: time of a step, use of the card, stages that share it.

    python benchmarks/gpu.py [--device cuda] [--size paper] [--minutes 8]      (benchmarks/gpu.sh
    finds a Python first)

Frames are simulated, in batches of one, as the paper trains. First each way to compute (sparse or
dense, precision, compiled) runs a training step over batches that lie on the card; its model FLOP
utilisation counts the dense network's products against the peak of the card's matrix units at that
precision (known for the cards below, else left out). Then the fastest way runs in the trainer, fed
by loader processes, as one stage and as several at once on the card, and packed: several networks
in one process on the same batches. Last, the time of the paper's whole gamma sweep at the best
rate: 2 detectors, 30 + 7 x 30 epochs of 3712 steps, and 3769 frames looked at after each.

Each measurement has a process of its own; those of the ways to compute are started together and
have the card in turn. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.core.records import Stage
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.flops import layer_flops
from fl3d.inference.detect import detect_frames, to_device
from fl3d.inference.load import build_detector
from fl3d.inference.precision import multiplying
from fl3d.inference.reproducibility import prepare
from fl3d.simulator.generate import Settings, write_folder
from fl3d.sweep.identity import result_config
from fl3d.training.build import build_optimizer, build_schedule
from fl3d.training.trainer import Trainer

ENDS = {"voxelnet": 0.6, "fcn3d": 1.0}  # share of the time by which a network has been measured
# compute, precision, compiled; the first is what a sweep does unless told otherwise
WAYS = [("sparse", "float32", False), ("dense", "float32", False), ("dense", "tf32", False)]
WAYS += [("dense", "bf16", False), ("dense", "bf16", True)]
PEAKS = {  # TFLOP/s of dense products as the makers give them: float32, tf32, bf16
    "H100": (67, 494, 989),
    "H200": (67, 494, 989),
    "A100": (19.5, 156, 312),
}
AT_ONCE = (1, 2, 4)
PACKED = 4
EPOCHS, TRAIN, VAL = 30 + 7 * 30, 3712, 3769  # of one detector in the paper's sweep
FRAMES = 32


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--size", default="paper", help="profile whose networks are measured")
    parser.add_argument(
        "--minutes", type=float, default=8, help="what does not fit is left out, and said"
    )
    parser.add_argument(
        "--one", nargs=3, metavar=("KIND", "FOLDER", "JSON"), help=argparse.SUPPRESS
    )
    arguments = parser.parse_args()
    if arguments.one:
        kind, folder, values = arguments.one
        print(json.dumps(KINDS[kind](Path(folder), **json.loads(values))))
        return
    started, seconds = time.monotonic(), 60 * arguments.minutes
    with tempfile.TemporaryDirectory() as folder:
        write_folder(Path(folder), Settings(train=FRAMES, val=1, seed=0))
        common = {"device": arguments.device, "size": arguments.size}
        print(
            f"{card(arguments.device)}, torch {torch.__version__}, frames of the simulator, "
            f"profile {arguments.size}"
        )
        ends = {name: started + seconds * end for name, end in ENDS.items()}
        found = {name: report(Path(folder), name, common, end) for name, end in ends.items()}
        hours = [one.get("sweep_hours") for one in found.values()]
        if None not in hours:
            print(f"the paper's whole sweep: {sum(hours):.1f} h")
        tell("gpu", {"card": card(arguments.device), **found})


def report(folder: Path, name: str, common: dict[str, Any], deadline: float) -> dict[str, Any]:
    """Measure one network, and print its tables."""
    flops = sum(
        layer_flops(
            lambda: build_detector(
                compose_config([f"detector={name}", f"profile={common['size']}"])
            )
        ).values()
    )
    found: dict[str, Any] = {"ways": {}, "shared": {}}
    ways = WAYS if common["device"] != "cpu" else [way for way in WAYS if way[1] != "tf32"]
    asked = [dict(zip(("compute", "precision", "compiled"), way, strict=True)) for way in ways]
    started = [start(folder, "steps", common | {"name": name} | one, False) for one in asked]
    for way, process in tqdm(list(zip(asked, started, strict=True)), desc=name, unit="way"):
        one, precision = {"name": name} | way, way["precision"]
        label = f"{way['compute']} {precision}{' compiled' if way['compiled'] else ''}"
        result = finish(process, deadline)
        if result is not None:
            found["ways"][label] = result | one
            tera = 3 * flops / result["step"] / 1e12
            peak = peak_of(card(common["device"]), precision)
            share = f"{100 * tera / peak:5.1f} % of {peak:g}" if peak else "  peak unknown"
            tqdm.write(
                f"  {name:8s} {label:22s} step {1e3 * result['step']:8.1f} ms, "
                f"look {1e3 * result['look']:7.1f} ms, "
                f"{result['gigabytes']:5.1f} GB, {tera:7.1f} dense TFLOP/s, {share}"
            )
    if all(way["compiled"] for way in found["ways"].values()):
        return found
    eager = [way for way in found["ways"].values() if not way["compiled"]]
    best = min(eager, key=lambda way: way["step"])  # compiling takes a minute of each process
    one = {key: best[key] for key in ("name", "compute", "precision", "compiled")}
    for label, rate in shared(folder, common | one, deadline):
        found["shared"][label] = rate
        print(
            f"  {name:8s} {label:22s} {rate['steps_per_second']:8.2f} steps/s, "
            f"{rate['waiting']:6.1%} of them waiting"
        )
    rates = [
        r["steps_per_second"] for label, r in found["shared"].items() if label.endswith("at once")
    ]
    rate = max(rates, default=1 / best["step"])
    looks = EPOCHS * VAL * best["look"] * min(1.0, (1 / best["step"]) / rate)  # shared as steps are
    found["sweep_hours"] = round((EPOCHS * TRAIN / rate + looks) / 3600, 2)
    print(f"  {name:8s} its half of the paper's sweep at that rate: {found['sweep_hours']} h")
    return found


def shared(
    folder: Path, one: dict[str, Any], deadline: float
) -> list[tuple[str, dict[str, float]]]:
    """Steps in a second of several stages on one card, each a process; and packed in one."""
    found = []
    for count in AT_ONCE:
        running = [
            start(folder, "train", one | {"seconds": 5, "index": k, "count": count})
            for k in range(count)
        ]
        ended = [
            result
            for result in (finish(process, deadline) for process in running)
            if result is not None
        ]
        if len(ended) == count:
            rate = sum(result["steps_per_second"] for result in ended)
            found.append(
                (f"{count} at once", {"steps_per_second": rate, "waiting": ended[0]["waiting"]})
            )
    packed = alone(folder, "packed", one | {"count": PACKED}, deadline)
    return [*found, (f"{PACKED} packed", packed)] if packed is not None else found


def start(
    folder: Path, kind: str, values: dict[str, Any], at_once: bool = True
) -> subprocess.Popen[str]:
    """A measurement's process; it goes on the card at once, or when ``finish`` waits for it."""
    command = [sys.executable, __file__, "--one", kind, str(folder), json.dumps(values)]
    turn = subprocess.DEVNULL if at_once else subprocess.PIPE
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, stdin=turn, text=True, **pipes)


def finish(process: subprocess.Popen[str], deadline: float) -> dict[str, Any] | None:
    """What a process found; None, and a line why, where it failed or had no time left."""
    try:
        left = max(0.1, deadline - time.monotonic())
        out, problem = process.communicate("\n" if process.stdin else None, timeout=left)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        tqdm.write(f"  left out for lack of time: {' '.join(process.args[4:])}")  # type: ignore[arg-type, index]
        return None
    if process.returncode != 0:
        tqdm.write(
            f"  failed: {(problem.strip().splitlines() or [f'exit code {process.returncode}'])[-1]}"
        )
        return None
    found: dict[str, Any] = json.loads(out.splitlines()[-1])
    return found


def alone(
    folder: Path, kind: str, values: dict[str, Any], deadline: float
) -> dict[str, Any] | None:
    """Measure in a process of its own."""
    return finish(start(folder, kind, values), deadline)


def config_of(
    name: str, compute: str, precision: str, compiled: bool, device: str, size: str
) -> dict[str, Any]:
    """A trial's config."""
    changes = [
        f"detector.compute={compute}",
        f"precision={precision}",
        f"compile={compiled}",
        f"device={device}",
    ]
    return compose_config([f"detector={name}", f"profile={size}", "loss.gamma=2", *changes])


def network(config: dict[str, Any]) -> tuple[Any, torch.optim.Optimizer]:
    """A detector on its device, and its optimiser."""
    return on_device(build_detector(config), config)


def on_device(detector: Any, config: dict[str, Any]) -> tuple[Any, torch.optim.Optimizer]:
    detector.to(config["device"])
    if config["compile"]:
        detector.compile_dense()
    return detector.train(), build_optimizer(config, detector)


def batches_of(detector: Any, folder: Path, device: str, count: int) -> list[Any]:
    """Batches of one frame, on the device."""
    kitti = KittiFolder(folder)
    frames = [kitti.frame(i) for i in kitti.split("train")[:count]]
    samples = [
        detector.encode(frame, np.random.default_rng(k), training=True)
        for k, frame in enumerate(frames)
    ]
    return [to_device(detector.collate([sample]), device) for sample in samples]


def steps(folder: Path, **way: Any) -> dict[str, float]:
    """Seconds of a training step and of a frame's detection, and peak memory on the card."""
    config = config_of(**way)
    prepare(0, config["device"], config["precision"])
    detector = build_detector(config)
    batches = batches_of(detector, folder, "cpu", 8)
    sys.stdin.readline()  # its turn
    detector, optimizer = on_device(detector, config)
    batches = [to_device(batch, config["device"]) for batch in batches]

    def step(batch: Any) -> None:
        with multiplying(config["precision"], config["device"]):
            terms = detector.loss(batch)
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()

    step_seconds = timed(step, batches, config["device"])
    memory = torch.cuda.max_memory_allocated() / 1e9 if config["device"] != "cpu" else 0.0
    kitti = KittiFolder(folder)
    frames, limits = Frames(kitti, kitti.split("train"), FRAMES), config["detections"]
    where = config["device"], config["precision"], 1, 0 if config["device"] == "cpu" else 4
    detect_frames(detector, frames, limits["max_boxes"], limits["min_score"], *where)  # compiles
    synchronize(config["device"])
    started = time.perf_counter()
    detect_frames(detector, frames, limits["max_boxes"], limits["min_score"], *where)
    synchronize(config["device"])
    look = (time.perf_counter() - started) / len(frames)
    return {"step": step_seconds, "look": look, "gigabytes": memory}


def packed(folder: Path, count: int, **way: Any) -> dict[str, float]:
    """Several networks in one process, each on a stream of its own, on the same batches."""
    config = config_of(**way)
    prepare(0, config["device"], config["precision"])
    pairs = [network(config) for _ in range(count)]
    batches = batches_of(pairs[0][0], folder, config["device"], 8)
    streams = [torch.cuda.Stream() if config["device"] != "cpu" else None for _ in pairs]

    def step(batch: Any) -> None:
        for (detector, optimizer), stream in zip(pairs, streams, strict=True):
            with torch.cuda.stream(stream), multiplying(config["precision"], config["device"]):
                terms = detector.loss(batch)
                optimizer.zero_grad()
                torch.stack(list(terms.values())).sum().backward()
                optimizer.step()

    return {"steps_per_second": count / timed(step, batches, config["device"]), "waiting": 0.0}


def train(folder: Path, seconds: float, index: int, count: int, **way: Any) -> dict[str, float]:
    """Steps in a second of the trainer, fed by loader processes, and how much of it was waiting."""
    config = config_of(**way)
    prepare(0, config["device"], config["precision"])
    detector, optimizer = network(config)
    schedule = dict(config["schedule"], stage={"lr_factor": 1.0}, batch_size=1, frames_per_epoch=8)
    schedule = {
        key: value
        for key, value in schedule.items()
        if key not in ("stages", "epochs", "save_every_steps")
    }
    stage = Stage(
        key="benchmark",
        name="warmup",
        config=result_config(config),
        parent=None,
        start_epoch=0,
        start_step=0,
        epochs=10_000,
        epoch_steps=8,
    )
    kitti = KittiFolder(folder)
    trainer = Trainer(
        stage,
        detector,
        optimizer,
        build_schedule(config | {"schedule": schedule}),
        Frames(kitti, kitti.split("train"), FRAMES),
        config["device"],
        0 if config["device"] == "cpu" else 4,
    )
    for _ in range(2):  # what is compiled or allocated once
        trainer.train_epoch(lambda: None)
    synchronize(config["device"])
    ready = [folder / f"ready-{way['name']}-{count}-{k}" for k in range(count)]
    ready[index].touch()
    while not all(
        path.exists() for path in ready
    ):  # all are warm: from here on they share the card
        time.sleep(0.01)
    trainer.waited, before, started = 0.0, trainer.step, time.perf_counter()
    while time.perf_counter() - started < seconds:
        trainer.train_epoch(lambda: None)
    synchronize(config["device"])
    elapsed = time.perf_counter() - started
    return {
        "steps_per_second": (trainer.step - before) / elapsed,
        "waiting": trainer.waited / elapsed,
    }


def timed(
    run: Callable[[Any], None], batches: list[Any], device: str, seconds: float = 2.5
) -> float:
    """Mean seconds of a call, over the batches again and again."""
    for batch in batches[:3]:
        run(batch)
    synchronize(device)
    started = time.perf_counter()
    for count, batch in enumerate(itertools.cycle(batches), start=1):
        run(batch)
        if count % len(batches) == 0:
            synchronize(device)
            if time.perf_counter() - started > seconds:
                return (time.perf_counter() - started) / count
    raise AssertionError


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


def card(device: str) -> str:
    """Its name."""
    return torch.cuda.get_device_name() if device != "cpu" else "CPU"


def peak_of(name: str, precision: str) -> float | None:
    """TFLOP/s of a card at a precision, where known."""
    for known, peaks in PEAKS.items():
        if known in name:
            return peaks[("float32", "tf32", "bf16").index(precision)]
    return None


KINDS: dict[str, Callable[..., dict[str, float]]] = {
    "steps": steps,
    "packed": packed,
    "train": train,
}

if __name__ == "__main__":
    main()
