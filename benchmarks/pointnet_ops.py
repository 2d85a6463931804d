"""PointNet++'s operators beside torch_cluster and SciPy, on the points of a frame.

    python benchmarks/pointnet_ops.py --kitti FOLDER --frame ID [--device cuda]

A frame's points are sampled as PointRCNN does at full size (16,384, of which the first level keeps
4096) and in profile quick (4096, 512). Milliseconds on one thread, the median of several runs that
take turns. "in torch" is what any other device does: the same to the bit, which is looked at here.
torch_cluster (pip install torch_cluster; it is compiled) is left out where it is not installed; its
``radius`` gives neighbours in no order. SciPy's trees are built anew, as every frame has its own.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.data.kitti import KittiFolder
from fl3d.inference.load import build_detector
from fl3d.inference.reproducibility import prepare
from fl3d.points import operators
from fl3d.points.operators import ball_query, farthest_points, gather, interpolate, nearest_known

RUNS = 7


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True)
    parser.add_argument("--frame", default="000010")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    prepare(0, arguments.device)
    sizes = ("quick", "paper")
    place = (arguments.kitti, arguments.frame)
    tell("pointnet_ops", {size: measure(*place, size, arguments.device) for size in sizes})


def measure(kitti: Path, frame_id: str, profile: str, device: str) -> dict[str, float]:
    """Print a row for each operator at one size; how many times as long other ways take."""
    config = compose_config(["detector=pointrcnn", f"profile={profile}"])
    level = config["detector"]["levels"][0]
    frame = KittiFolder(kitti).frame(frame_id)
    sample = build_detector(config).encode(frame, np.random.default_rng(0), training=False)
    points = torch.from_numpy(sample["points"]).to(device)[None]
    count, radius, most = level["count"], level["radii"][1], level["samples"][1]
    centers = gather(points, farthest_points(points, count))
    features = torch.randn(1, count, 64, device=device)
    print(
        f"\n{profile}: {points.shape[1]} points, {count} kept, "
        f"balls of {radius} m and {most} points ({device})"
    )
    one, some = points[0], centers[0]
    rows: dict[str, dict[str, Callable[[], object]]] = {
        "farthest points": {"fl3d": lambda: farthest_points(points, count)},
        "ball query": {"fl3d": lambda: ball_query(points, centers, [radius], [most])},
        "3 nearest": {"fl3d": lambda: nearest_known(points, centers, 3)},
        "3 nearest, interpolate": {"fl3d": lambda: interpolate(points, centers, features)},
    }
    if device == "cpu":
        from scipy.spatial import cKDTree

        plain, around = one.numpy(), some.numpy()
        rows["ball query"]["scipy"] = lambda: cKDTree(plain).query(
            around, k=most, distance_upper_bound=radius
        )
        rows["3 nearest"]["scipy"] = lambda: cKDTree(around).query(plain, k=3)
        for name, ways in rows.items():
            ways["in torch"] = partial(by_torch, ways["fl3d"])
            if not same(ways["fl3d"](), ways["in torch"]()):
                print(f"  {name}: not the same to the bit")
    try:
        import torch_cluster
    except ImportError:
        print("torch_cluster is not installed")
    else:
        ratio = count / len(one)
        rows["farthest points"]["torch_cluster"] = lambda: torch_cluster.fps(
            one, ratio=ratio, random_start=False
        )
        rows["ball query"]["torch_cluster"] = lambda: torch_cluster.radius(
            one, some, radius, max_num_neighbors=most
        )
        rows["3 nearest"]["torch_cluster"] = lambda: torch_cluster.knn(some, one, 3)
    found = {}
    for name, ways in rows.items():
        times = timed(ways, device)
        others = {way: taken for way, taken in times.items() if way != "fl3d"}
        found |= {f"{name}: {way} / fl3d": t / times["fl3d"] for way, t in others.items()}
        ratios = [f"{way} {t:.2f} ms ({t / times['fl3d']:.2f} x)" for way, t in times.items()]
        print(f"  {name:24s}", "; ".join(ratios), flush=True)
    return found


def by_torch(call: Callable[[], object]) -> object:
    """A call as a device makes it for which nothing is compiled."""
    with patch.multiple(operators, plain=lambda *_: None, is_single=lambda *_: False):
        return call()


def same(found: Any, other: Any) -> bool:
    """Whether tensors, or several of them, are equal."""
    if torch.is_tensor(found):
        return torch.equal(found, other)
    return all(torch.equal(*pair) for pair in zip(found, other, strict=True))


def timed(ways: dict[str, Callable[[], object]], device: str) -> dict[str, float]:
    """Median of the milliseconds of a few calls of each, in turn, after one that does not count."""
    times: dict[str, list[float]] = {way: [] for way in ways}
    clock = time.process_time if device == "cpu" else time.perf_counter
    for run in range(RUNS + 1):
        for way, call in ways.items():
            started = clock()
            call()
            if device != "cpu":
                torch.cuda.synchronize()
            times[way] += [clock() - started] * (run > 0)
    return {way: 1000 * statistics.median(some) for way, some in times.items()}


if __name__ == "__main__":
    main()
