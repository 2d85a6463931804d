"""Rotated overlaps and suppression: ours beside shapely, and how far apart their answers are.

    python benchmarks/iou_nms.py

Wall milliseconds of one thread after compilation, the best of several. 500 x 500 car-sized boxes
spread over 70 x 80 m; suppression of 2000 of them, spread and in heaps of 20.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import shapely
from shapely import STRtree

from benchmarks.told import tell
from fl3d.geometry.iou import bev_iou
from fl3d.geometry.nms import nms


def boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    place = (rng.uniform(0, 70, n), rng.uniform(-40, 40, n))
    return np.column_stack(
        [*place, rng.normal(3.9, 0.4, n), rng.normal(1.6, 0.1, n), rng.uniform(-3, 3, n)]
    )


def polygons(rectangles: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(rectangles[:, 4]), np.sin(rectangles[:, 4])
    rings = np.empty((len(rectangles), 4, 2))
    for k, (a, b) in enumerate(((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))):
        along, across = a * rectangles[:, 2], b * rectangles[:, 3]
        rings[:, k, 0] = rectangles[:, 0] + along * cos - across * sin
        rings[:, k, 1] = rectangles[:, 1] + along * sin + across * cos
    return shapely.polygons(rings)


def shapely_iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Pairs from a tree, intersections vectorised: the fast way to use shapely."""
    p, q = polygons(a), polygons(b)
    i, j = STRtree(q).query(p)
    shared = shapely.area(shapely.intersection(p[i], q[j]))
    out = np.zeros((len(a), len(b)))
    out[i, j] = shared / (shapely.area(p[i]) + shapely.area(q[j]) - shared)
    return out


def shapely_nms(rectangles: np.ndarray, scores: np.ndarray, iou: float) -> list[int]:
    overlap = shapely_iou(rectangles, rectangles) > iou
    order = np.argsort(-scores, kind="stable")
    alive, kept = np.ones(len(order), dtype=bool), []
    for i in order:
        if alive[i]:
            kept.append(int(i))
            alive &= ~overlap[i]
    return kept


def best(work: Callable[[], object], times: int = 20) -> float:
    seconds = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return min(seconds) * 1000


def main() -> None:
    rng = np.random.default_rng(0)
    a, b = boxes(rng, 500), boxes(rng, 500)
    error = np.abs(bev_iou(a, b) - shapely_iou(a, b)).max()
    ours, theirs = best(lambda: bev_iou(a, b)), best(lambda: shapely_iou(a, b))
    print(
        f"IoU 500 x 500    fl3d {ours:.2f} ms ({2.5e8 / ours:.1e} pairs/s)   "
        f"shapely {theirs:.1f} ms = {theirs / ours:.0f} x"
    )
    print(f"largest difference {error:.1e}")
    found = {"IoU ms": ours, "IoU: shapely / fl3d": theirs / ours, "IoU: difference": float(error)}
    spread = boxes(rng, 2000)
    heaps = np.repeat(boxes(rng, 100), 20, axis=0) + rng.normal(0, 0.3, (2000, 5)) * [
        1,
        1,
        0.1,
        0.1,
        0.1,
    ]
    scores = rng.random(2000)
    for name, case in (("spread", spread), ("heaps", heaps)):
        nms(case, scores, 0.1, "rotated", 2000)
        nms(case, scores, 0.1, "standup", 2000)
        same = nms(case, scores, 0.1, "rotated", 2000).tolist() == shapely_nms(case, scores, 0.1)
        rotated = best(lambda case=case: nms(case, scores, 0.1, "rotated", 2000))
        hulls = best(lambda case=case: nms(case, scores, 0.1, "standup", 2000))
        theirs = best(lambda case=case: shapely_nms(case, scores, 0.1), 3)
        print(
            f"NMS 2000 {name:7} fl3d rotated {rotated:.2f} ms, standup {hulls:.2f} ms   "
            f"shapely rotated {theirs:.0f} ms = {theirs / rotated:.0f} x   same boxes kept: {same}"
        )
        found |= {f"NMS {name}: shapely / fl3d": theirs / rotated, f"NMS {name}: same": same}
    tell("iou_nms", found)


if __name__ == "__main__":
    main()
