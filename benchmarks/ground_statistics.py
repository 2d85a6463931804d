"""How even the simulated ground is beside KITTI's, and where cars' boxes begin above it.

    python benchmarks/ground_statistics.py --kitti FOLDER --frames FILE [--people 1] [--simulated 100]

Along 15 neighbours of a ring on the ground ranges are held against a parabola: what is left is the range's noise and
the ground's unevenness. Prints a table in Markdown: simulated | KITTI.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.splits import read_split
from fl3d.simulator.generate import Settings, generate
from fl3d.simulator.hdl64 import ELEVATIONS, ORIGINS

Float = NDArray[np.float64]
RUN = 15  # neighbours of a ring
COLUMN = 0.17  # degrees between them, and a little
BINS = ((5, 10), (10, 15), (15, 20), (20, 30), (30, 50))  # metres


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True)
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--people", type=float, default=1.0, help="the rate; 0: data=simulated")
    parser.add_argument("--simulated", type=int, default=100, help="frames (default: 100)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        settings = Settings(given.simulated, 0, seed=1, people=given.people or None)
        ours = KittiFolder(generate(Path(name), settings))
        both = [measured(ours, ours.split("train"))]
        both.append(measured(KittiFolder(given.kitti), read_split(given.frames)))
    print("| | simulated | KITTI |\n|---|---|---|")
    for side, near, far in (("road", 0.0, 2.5), ("beside", 5.0, 99.0)):
        for low, high in BINS:
            cells = [_cell(runs[_chosen(runs, near, far, low, high), 2]) for runs, _ in both]
            print(f"| {side}, {low} to {high} m: range off a parabola, cm | {' | '.join(cells)} |")
    for low, high in ((0, 15), (15, 30)):
        cells = [_cell(cars[(cars[:, 0] >= low) & (cars[:, 0] < high), 1]) for _, cars in both]
        print(f"| ground to a car's box, {low} to {high} m, cm | {' | '.join(cells)} |")


def _chosen(runs: Float, near: float, far: float, low: float, high: float) -> NDArray[np.bool_]:
    beside = (runs[:, 1] >= near) & (runs[:, 1] < far)
    return np.asarray(beside & (runs[:, 0] >= low) & (runs[:, 0] < high))


def _cell(values: Float) -> str:
    values = values[np.isfinite(values)]
    if not len(values):
        return "(none)"
    return " / ".join(f"{100 * v:.1f}" for v in np.quantile(values, [0.25, 0.5, 0.75]))


def measured(folder: KittiFolder, ids: Sequence[str]) -> tuple[Float, Float]:
    """Runs (N, 3): distance, metres beside the axis, spread of the range. Cars (M, 2): distance, ground to box."""
    runs, cars = [], []
    for frame_id in ids:
        frame = folder.frame(frame_id)
        points = frame.points_velo[:, :3].astype(np.float64)
        taken, own = _boxes(frame, points)
        cars.append(own)
        level = points[:, 2] + 1.73 - 0.008 * points[:, 0] + 0.009 * points[:, 1]
        runs.append(_runs(points[(np.abs(level) < 0.35) & ~taken]))
    return np.concatenate(runs), np.concatenate(cars)


def _boxes(frame: Frame, points: Float) -> tuple[NDArray[np.bool_], Float]:
    """Points within 30 cm of a box; and of visible cars distance, and metres from the ground to the box."""
    labels = frame.labels.select(frame.labels.types != "DontCare")
    taken, cars = np.zeros(len(points), dtype=np.bool_), []
    for k, (x, y, z, _, w, length, yaw) in enumerate(
        frame.calibration.boxes_to_velo(labels.boxes_cam)
    ):
        q = points - (x, y, z)
        u = np.abs(q[:, 0] * np.cos(yaw) + q[:, 1] * np.sin(yaw)) - length / 2
        v = np.abs(q[:, 1] * np.cos(yaw) - q[:, 0] * np.sin(yaw)) - w / 2
        taken |= (u < 0.3) & (v < 0.3)
        around = ((u > 0.1) | (v > 0.1)) & (u < 1) & (v < 1) & (np.abs(q[:, 2]) < 0.4)
        if labels.types[k] == "Car" and labels.occluded[k] == 0 and around.sum() >= 12:
            low = q[around, 2]
            cars.append((np.hypot(x, y), -np.median(low[low <= np.median(low)])))
    return taken, np.array(cars).reshape(-1, 2)


def _runs(points: Float) -> Float:
    reach = np.hypot(points[:, 0], points[:, 1])
    miss = np.abs(points[:, 2:3] - ORIGINS - reach[:, None] * np.tan(np.deg2rad(ELEVATIONS)))
    ring, azimuth = miss.argmin(axis=1), np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))
    found = []
    for number in np.unique(ring):
        row = np.flatnonzero(ring == number)
        row = row[np.argsort(azimuth[row])]
        for start in range(0, len(row) - RUN, RUN):
            own = row[start : start + RUN]
            if np.ptp(azimuth[own]) > RUN * COLUMN * 1.3:
                continue
            at = azimuth[own] - azimuth[own].mean()
            left = reach[own] - np.polyval(np.polyfit(at, reach[own], 2), at)
            if np.abs(left).max() < 1.5:
                beside = abs(float(points[own, 1].mean()))
                found.append((reach[own].mean(), beside, left.std()))
    return np.array(found).reshape(-1, 3)


if __name__ == "__main__":
    main()
