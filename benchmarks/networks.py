"""Sparse layers beside dense ones: time, memory and error on real frames, one thread.

    python benchmarks/networks.py --kitti FOLDER --frames FILE [--sizes paper quick]

The frame of FILE with the median number of voxels is taken (and, with --simulated FOLDER, one of a
simulated folder). Each measurement has a process of its own: CPU seconds of one forward pass and of
one training step (forward, backward, optimiser), a frame each, and peak memory. Dense runs in
torch's two memory layouts; sparse also on four frames at once, for each of them, and with products
in bfloat16. The error is that of the sparse network's outputs against the dense one's, both in
float64, relative to the largest output; the dense one's 3D batch normalisations sum in two passes,
since torch's own lose four digits over a million positions that are nearly alike.

The last line is one JSON object; of each network and size on KITTI's frame it has "forward_ratio",
"step_ratio" and "max_error_float64"; ratios are dense contiguous / sparse. Networks: voxelnet_middle
(its 3D convolutions), voxelnet, fcn3d.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.data.kitti import KittiFolder
from fl3d.data.splits import read_split
from fl3d.data.voxels import occupancy
from fl3d.detectors import fcn3d, voxelnet
from fl3d.detectors.base import Batch, Detector
from fl3d.detectors.blocks import scatter_dense
from fl3d.inference.load import build_detector
from fl3d.inference.precision import multiplying
from fl3d.sparse.background import BackgroundMap, dense
from fl3d.sparse.norms import Relu
from fl3d.training.build import build_optimizer

NETWORKS = {"voxelnet_middle": "voxelnet", "voxelnet": "voxelnet", "fcn3d": "fcn3d"}
LAYOUTS = {"contiguous": torch.contiguous_format, "channels_last": torch.channels_last_3d}
WAYS = ("contiguous", "channels_last", "sparse", "sparse, 4 at once", "sparse, bf16")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True)
    parser.add_argument("--frames", type=Path, help="a list of frame ids, one a line")
    parser.add_argument("--simulated", type=Path, help="a simulated KITTI folder, measured beside")
    parser.add_argument(
        "--sizes", nargs="+", default=["quick", "paper"], choices=["quick", "paper"]
    )
    parser.add_argument(
        "--one", nargs=4, metavar=("NETWORK", "WAY", "SIZE", "FRAME"), help=argparse.SUPPRESS
    )
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.kitti, *arguments.one)))
        return
    ids = read_split(arguments.frames)
    report: dict[str, Any] = {}
    for folder, chosen in places(arguments.kitti, ids, arguments.simulated):
        for size in arguments.sizes:
            for network in NETWORKS:
                found = {way: alone(folder, network, way, size, chosen) for way in (*WAYS, "error")}
                show(f"{network}, {size}, {folder.name}/{chosen}", found)
                if folder == arguments.kitti:
                    report[f"{network}, {size}"] = {
                        "forward_ratio": round(
                            found["contiguous"]["forward"] / found["sparse"]["forward"], 2
                        ),
                        "step_ratio": round(
                            found["contiguous"]["step"] / found["sparse"]["step"], 2
                        ),
                        "max_error_float64": found["error"]["error"],
                    }
    tell("networks", report)


def places(kitti: Path, ids: list[str], simulated: Path | None) -> list[tuple[Path, str]]:
    """Folders, and the typical frame of each."""
    found = [(kitti, typical(kitti, ids))]
    if simulated is not None:
        found.append((simulated, typical(simulated, KittiFolder(simulated).split("train")[:50])))
    return found


def typical(root: Path, ids: list[str]) -> str:
    """The frame whose number of VoxelNet's full-size voxels is the median."""
    grid = build("voxelnet", "dense", "paper").grid
    counts = [len(occupancy(KittiFolder(root).frame(i).points_velo, grid)) for i in ids]
    return ids[int(np.argsort(counts)[len(counts) // 2])]


def alone(kitti: Path, network: str, way: str, size: str, frame: str) -> dict[str, float]:
    """Measure in a process of its own."""
    command = [sys.executable, __file__, "--kitti", str(kitti), "--one", network, way, size, frame]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def build(detector: str, compute: str, size: str) -> Any:
    """A detector of a profile, the same weights each time."""
    torch.manual_seed(0)
    return build_detector(config(detector, compute, size))


def config(detector: str, compute: str, size: str) -> dict[str, Any]:
    """A trial's config."""
    return compose_config(
        [f"detector={detector}", f"profile={size}", f"detector.compute={compute}"]
    )


def measure(kitti: Path, network: str, way: str, size: str, frame: str) -> dict[str, float]:
    """Seconds of a forward pass and of a step, and peak memory; or the error in float64."""
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    detector = NETWORKS[network]
    if way == "error":
        return {"error": error(kitti, network, size, frame)}
    model = build(detector, "dense" if way in LAYOUTS else "sparse", size).train()
    if way in LAYOUTS:
        keep_layout(LAYOUTS[way])
    count = 4 if way == "sparse, 4 at once" else 1
    batch = encode(model, kitti, frame, count)
    optimizer = build_optimizer(config(detector, "dense", size), model)
    plain, parameters = runner(model, network, batch)

    def run() -> Tensor:
        with multiplying("bf16" if way == "sparse, bf16" else "float32", "cpu"):
            return plain()

    rounds = 1 if size == "paper" else 5
    run()  # what is compiled, allocated or chosen once
    forward = seconds(run, rounds)

    def step() -> None:
        optimizer.zero_grad()
        run().backward()
        optimizer.step()

    step_seconds = seconds(step, rounds)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {
        "forward": forward / count,
        "step": step_seconds / count,
        "gigabytes": memory,
        "parameters": parameters,
    }


def encode(model: Detector, kitti: Path, frame: str, count: int = 1) -> Batch:
    """A batch of a frame, so many times, with its targets; rulebooks are made here."""
    sample = model.encode(KittiFolder(kitti).frame(frame), np.random.default_rng(0), training=True)
    return model.collate([sample] * count)


def runner(model: Any, network: str, batch: Batch) -> tuple[Callable[[], Tensor], int]:
    """What is timed: a function from nothing to a scalar."""
    n = sum(p.numel() for p in model.parameters())
    if network != "voxelnet_middle":
        return (lambda: torch.stack(list(model.loss(batch).values())).sum()), n
    with torch.no_grad():
        voxels = model.feature_net(batch["rows"], batch["lengths"], None)
    voxels.requires_grad_()
    return (lambda: middle(model, voxels, batch).square().mean()), n


def middle(model: Any, voxels: Tensor, batch: Batch) -> Tensor:
    """VoxelNet's 3D convolutions alone, on as many frames as the batch has."""
    if "layout" in batch:  # the maps are not so full that all layers are dense from the start
        return dense(model.middle(BackgroundMap.from_voxels(voxels, batch["layout"])))
    out: Tensor = model.middle(
        voxelnet.scatter_dense(voxels, batch["cells"], (int(batch["size"]), *model.grid.shape))
    )
    return out


def error(kitti: Path, network: str, size: str, frame: str) -> float:
    """Largest difference of outputs in float64, relative to the largest output."""
    outputs = []
    for compute in ("dense", "sparse"):
        model = build(NETWORKS[network], compute, size).double().train()
        if compute == "dense":
            normalise_in_two_passes(model)
        batch = encode(model, kitti, frame)
        with torch.no_grad():
            if network == "voxelnet_middle":
                voxels = model.feature_net(batch["rows"].double(), batch["lengths"], None)
                outputs.append([middle(model, voxels, batch)])
            else:
                outputs.append(list(model(batch)))
    return max(float((a - b).abs().max() / a.abs().max()) for a, b in zip(*outputs, strict=True))


def normalise_in_two_passes(model: torch.nn.Module) -> None:
    """Give the 3D batch normalisations of a network in training their exact statistics."""

    def forward(module: Any, x: Tensor, relu: Relu = "none") -> Tensor:
        x = x.relu() if relu == "before" else x
        flat = x.movedim(1, 0).flatten(1)
        mean = flat.mean(1, keepdim=True)
        mean = mean + (flat - mean).mean(1, keepdim=True)
        low = flat - mean
        scale = torch.rsqrt((low * low).mean(1, keepdim=True) + module.eps) * module.weight[:, None]
        out = (low * scale + module.bias[:, None]).view(x.movedim(1, 0).shape).movedim(0, 1)
        return out.relu() if relu == "behind" else out

    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm3d):
            module.forward = functools.partial(forward, module)


def keep_layout(layout: torch.memory_format) -> None:
    """Let the dense networks begin in one memory layout."""

    def scatter(values: Tensor, cells: Tensor, shape: tuple[int, ...]) -> Tensor:
        return scatter_dense(values, cells, shape).clone(memory_format=layout)

    voxelnet.scatter_dense = fcn3d.scatter_dense = scatter


def seconds(run: Callable[[], object], rounds: int) -> float:
    """CPU seconds of one call, the fastest of some."""
    times = []
    for _ in range(rounds):
        started = time.process_time()
        run()
        times.append(time.process_time() - started)
    return min(times)


def show(title: str, found: dict[str, dict[str, float]]) -> None:
    sparse = found["sparse"]
    print(f"{title}; error in float64 {found['error']['error']:.1e}")
    for way in WAYS:
        own = found[way]
        ratios = (
            f"{own['forward'] / sparse['forward']:6.2f} x, {own['step'] / sparse['step']:6.2f} x"
        )
        print(
            f"  {way:17s} forward {own['forward']:8.4f} s, step {own['step']:8.4f} s ({ratios}), "
            f"{own['gigabytes']:.2f} GB",
            flush=True,
        )


if __name__ == "__main__":
    main()
