"""How like KITTI the simulated frames are: distributions of labels and clouds, side by side.

    python benchmarks/sim_statistics.py --kitti FOLDER --frames FILE [--figure sim_statistics.png]

Labels are compared with all label files of FOLDER's train split, clouds with those of the frames in
FILE. What is compared, and in which panel it stands, is `PANELS`; each prints one line with the
largest difference as well.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from benchmarks.told import tell
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.splits import read_split
from fl3d.simulator.generate import Settings, generate
from fl3d.simulator.hdl64 import ELEVATIONS, ORIGINS

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Float = NDArray[np.float64]
COLUMN = 0.16706  # degrees between two firings


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True)
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument(
        "--simulated", type=int, default=300, help="frames to simulate (default: 300)"
    )
    parser.add_argument("--figure", type=Path, default=Path("sim_statistics.png"))
    arguments = parser.parse_args()
    kitti = KittiFolder(arguments.kitti)
    ids = read_split(arguments.frames)
    with tempfile.TemporaryDirectory() as name:
        simulated = KittiFolder(generate(Path(name), Settings(arguments.simulated, 0, seed=1)))
        theirs = Collected.of(kitti, kitti.split("train"), ids)
        ours = Collected.of(simulated, simulated.split("train"), simulated.split("train"))
    draw(theirs, ours, arguments.figure)


@dataclass
class Collected:
    """Columns of all objects, and figures of all clouds.

    Args:
        labels: (N, 9) frame, x, y, |heading| in degrees, 2D height, occlusion, truncation, length,
        height over plane. kinds: (N,) types. n_labelled: frames of the labels. points: (M, 8) x, y,
        height over the ground plane, reflectance, ring, azimuth (degrees), class, frame. cars: (C,
        3) distance, points inside, whether wholly visible. inside: (P, 2) of points in visible
        cars: share of the height, metres to the nearest visible side. n_frames: frames of the
        clouds.
    """

    labels: Float
    kinds: NDArray[np.str_]
    n_labelled: int
    points: Float
    cars: Float
    inside: Float
    n_frames: int

    @classmethod
    def of(cls, folder: KittiFolder, labelled: list[str], clouds: list[str]) -> Collected:
        """Read labels of some frames and clouds of others."""
        labels, kinds = [], []
        for number, frame_id in enumerate(labelled):
            own, calibration = folder.read_labels(frame_id), folder.read_calibration(frame_id)
            boxes = calibration.boxes_to_velo(own.boxes_cam)
            yaw = np.abs(np.rad2deg(boxes[:, 6]))
            height = own.boxes_image[:, 3] - own.boxes_image[:, 1]
            columns = (
                np.full(len(own), number),
                boxes[:, 0],
                boxes[:, 1],
                np.minimum(yaw, 180 - yaw),
                height,
            )
            labels.append(
                np.column_stack([*columns, own.occluded, own.truncated, boxes[:, 5], boxes[:, 2]])
            )
            kinds.append(own.types)
        parts = [_cloud(folder.frame(frame_id), number) for number, frame_id in enumerate(clouds)]
        points, cars, inside = (np.concatenate([p[k] for p in parts]) for k in range(3))
        return cls(
            np.concatenate(labels),
            np.concatenate(kinds),
            len(labelled),
            points,
            cars,
            inside,
            len(clouds),
        )


def _cloud(frame: Frame, number: int) -> tuple[Float, Float, Float]:
    xyz = frame.points_velo[:, :3].astype(np.float64)
    rho = np.hypot(xyz[:, 0], xyz[:, 1])
    miss = np.abs(xyz[:, 2:3] - ORIGINS - rho[:, None] * np.tan(np.deg2rad(ELEVATIONS)))
    ring = miss.argmin(axis=1)
    near = (
        (np.abs(xyz[:, 1]) < 4)
        & (xyz[:, 0] < 25)
        & (np.abs(xyz[:, 2] + 1.72 - 0.008 * xyz[:, 0]) < 0.4)
    )
    design = np.column_stack([np.ones(near.sum()), xyz[near][:, :2]])
    plane = np.array([-1.72, 0.008, 0.0])
    for _ in range(4):
        residual = xyz[near][:, 2] - design @ plane
        good = np.abs(residual - np.median(residual)) < 0.12
        plane = np.linalg.lstsq(design[good], xyz[near][good, 2], rcond=None)[0]
    height = xyz[:, 2] - plane[0] - xyz[:, :2] @ plane[1:]
    kind = np.where(np.abs(height) < 0.15, 0.0, 3.0)
    calibration, labels = frame.calibration, frame.labels
    cars, inside = [], []
    boxes = calibration.boxes_to_velo(labels.boxes_cam)
    for k, box in enumerate(boxes):
        if labels.types[k] == "DontCare":
            continue
        x, y, z, h, w, length, yaw = box
        u = (xyz[:, 0] - x) * np.cos(yaw) + (xyz[:, 1] - y) * np.sin(yaw)
        v = (xyz[:, 1] - y) * np.cos(yaw) - (xyz[:, 0] - x) * np.sin(yaw)
        t = (xyz[:, 2] - z) / h
        own = (np.abs(u) < length / 2) & (np.abs(v) < w / 2) & (t > 0) & (t < 1)
        kind[own & (height > 0.15)] = 1.0 if labels.types[k] == "Car" else 2.0
        if labels.types[k] != "Car":
            continue
        visible = labels.occluded[k] == 0 and labels.truncated[k] == 0
        cars.append((np.hypot(x, y), own.sum(), visible))
        if visible and np.hypot(x, y) < 40:
            ou, ov = -x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) - y * np.cos(yaw)
            gaps = []
            if abs(ou) > length / 2:
                gaps.append(length / 2 - np.sign(ou) * u[own])
            if abs(ov) > w / 2:
                gaps.append(w / 2 - np.sign(ov) * v[own])
            inside.append(np.column_stack([t[own], np.min(gaps, axis=0)]))
    azimuth = np.rad2deg(np.arctan2(xyz[:, 1], xyz[:, 0]))
    points = np.column_stack(
        [
            xyz[:, :2],
            height,
            frame.points_velo[:, 3],
            ring,
            azimuth,
            kind,
            np.full(len(xyz), number),
        ]
    )
    empty = np.zeros((0, 2))
    return points, np.array(cars).reshape(-1, 3), np.concatenate([*inside, empty])


def shares(values: Float, edges: Float) -> Float:
    """Histogram as shares."""
    return np.histogram(values, edges)[0] / max(1, len(values))


def of_cars(c: Collected) -> Float:
    return c.labels[c.kinds == "Car"]


def cars_per_frame(c: Collected) -> Float:
    counts = np.bincount(of_cars(c)[:, 0].astype(int), minlength=c.n_labelled)
    return shares(np.minimum(counts, 20), np.arange(-0.5, 21))


def levels(c: Collected) -> Float:
    own = of_cars(c)
    height, occluded, truncated = own[:, 4], own[:, 5], own[:, 6]
    limits = ((40, 0, 0.15), (25, 1, 0.3), (25, 2, 0.5))
    reached = [((height >= h) & (occluded <= o) & (truncated <= t)).mean() for h, o, t in limits]
    return np.array([*(np.mean(occluded == k) for k in range(4)), np.mean(truncated > 0), *reached])


def others(c: Collected) -> Float:
    kinds = ("Van", "Truck", "Tram", "Misc", "Pedestrian", "Cyclist", "Person_sitting", "DontCare")
    return np.array([(c.kinds == kind).sum() / c.n_labelled for kind in kinds])


def kinds_of_points(c: Collected) -> Float:
    return np.array([np.mean(c.points[:, 6] == k) for k in range(4)])


def returns(c: Collected) -> Float:
    """Share of rays that come back, by group of four rings and by azimuth."""
    values = []
    for low, high in ((0, 5), (5, 10), (10, 20), (20, 38)):
        chosen = c.points[(np.abs(c.points[:, 5]) >= low) & (np.abs(c.points[:, 5]) < high)]
        rays = 2 * (high - low) / COLUMN * 4 * c.n_frames
        values.append(np.histogram(chosen[:, 4], np.arange(0, 41, 4) - 0.5)[0] / rays)
    return np.concatenate(values)


def heights(c: Collected) -> Float:
    edges = np.array([-2, -0.5, -0.15, 0.15, 0.5, 1, 1.5, 2, 3, 5, 20])
    lateral = np.abs(c.points[:, 1])
    bands = [(0, 5), (5, 10), (10, 20), (20, 45)]
    return np.concatenate(
        [shares(c.points[(lateral >= a) & (lateral < b), 2], edges) for a, b in bands]
    )


def ranges(c: Collected) -> Float:
    counts = (
        np.histogram(np.hypot(c.points[:, 0], c.points[:, 1]), np.arange(0, 81, 5))[0] / c.n_frames
    )
    return np.log10(counts + 1)


def cells(c: Collected) -> Float:
    """Hundreds of occupied cells of 0.4 m a frame, by their highest point and by distance."""
    found = []
    for low, high in ((0, 20), (20, 40), (40, 70)):
        own = c.points[(c.points[:, 0] >= low) & (c.points[:, 0] < high) & (c.points[:, 6] == 3)]
        key = own[:, 7] * 1e8 + np.floor(own[:, 0] / 0.4) * 1e4 + np.floor(own[:, 1] / 0.4) + 500
        order = np.lexsort((own[:, 2], key))
        last = np.append(np.diff(key[order]) != 0, True)
        found.append(np.histogram(own[order][last, 2], [-5, 0.5, 2, 20])[0] / c.n_frames / 100)
    return np.concatenate(found)


def steps(c: Collected) -> Float:
    """Quantiles of range steps between neighbours of one ring and class, log10 metres."""
    found = []
    reach = np.hypot(c.points[:, 0], c.points[:, 1])
    order = np.lexsort((c.points[:, 5], c.points[:, 4], c.points[:, 7]))
    p, r = c.points[order], reach[order]
    same = (np.diff(p[:, 4]) == 0) & (np.diff(p[:, 7]) == 0) & (np.diff(p[:, 5]) < 0.25)
    for kind, low, high in ((0, -9, 9), (1, -9, 9), (3, 0.15, 2), (3, 2, 9)):
        own = (
            (p[:-1, 6] == kind) & (p[1:, 6] == kind) & (p[:-1, 2] > low) & (p[:-1, 2] < high) & same
        )
        found.append(
            np.log10(
                np.quantile(np.abs(np.diff(r))[own], [0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99])
                + 1e-3
            )
        )
    return np.concatenate(found)


def points_of_cars(c: Collected) -> Float:
    """Median points of wholly visible cars by distance, log10."""
    own = c.cars[c.cars[:, 2] == 1]
    places = np.arange(5, 50, 5)
    chosen = [own[(own[:, 0] >= d) & (own[:, 0] < d + 5), 1] for d in places]
    return np.array([np.log10(np.median(n) + 1) if len(n) else np.nan for n in chosen])


def insets(c: Collected) -> Float:
    """How far within the box the points of a car lie, median by tenth of its height."""
    tenth = np.minimum((c.inside[:, 0] * 10).astype(int), 9)
    return np.array(
        [np.median(c.inside[tenth == k, 1]) if (tenth == k).any() else np.nan for k in range(10)]
    )


def body_heights(c: Collected) -> Float:
    return shares(c.inside[:, 0], np.linspace(0, 1, 11))


def reflectances(c: Collected) -> Float:
    """Quantiles 25, 50, 75, 95 of ground by range, cars, and all else."""
    reach = np.hypot(c.points[:, 0], c.points[:, 1])
    chosen = [
        (c.points[:, 6] == 0) & (reach >= a) & (reach < a + 5) for a in (5, 10, 15, 20, 25, 30)
    ]
    chosen += [
        c.points[:, 6] == 1,
        (c.points[:, 6] == 3) & (c.points[:, 2] < 2),
        (c.points[:, 6] == 3) & (c.points[:, 2] > 2),
    ]
    return np.concatenate(
        [np.quantile(c.points[mask, 3], [0.25, 0.5, 0.75, 0.95]) for mask in chosen]
    )


Panel = tuple[str, Callable[[Collected], Float]]
PANELS: tuple[Panel, ...] = (
    ("cars a frame, 0 to 20", cars_per_frame),
    ("cars: x in steps of 5 m", lambda c: shares(of_cars(c)[:, 1], np.arange(0, 91, 5))),
    ("cars: |y| in steps of 2 m", lambda c: shares(np.abs(of_cars(c)[:, 2]), np.arange(0, 31, 2))),
    (
        "cars: heading to the x axis in steps of 10 degrees",
        lambda c: shares(of_cars(c)[:, 3], np.arange(0, 91, 10)),
    ),
    (
        "cars: height of the 2D box in steps of 15 pixels",
        lambda c: shares(of_cars(c)[:, 4], np.arange(0, 256, 15)),
    ),
    ("cars: occlusion 0 to 3; truncated; easy, moderate, hard", levels),
    ("others a frame: Van, Truck, Tram, Misc, Ped., Cyc., sitting, DontCare", others),
    (
        "cars: length in steps of 0.25 m",
        lambda c: shares(of_cars(c)[:, 7], np.arange(2.5, 5.6, 0.25)),
    ),
    ("points: ground, cars, other boxes, else", kinds_of_points),
    ("rays that return: rings 0 to 39 by fours; |azimuth| 0-5, -10, -20, -38", returns),
    ("heights over the road by |y| 0-5, -10, -20, -45", heights),
    ("points a frame by range in steps of 5 m, log10", ranges),
    ("cells of 0.4 m a frame / 100: low, 0.5-2 m, higher; x 0-20, -40, -70", cells),
    ("range steps, quantiles, log10 m: ground, cars, else low, else high", steps),
    ("points on visible cars by distance from 5 m, log10 of the median", points_of_cars),
    ("metres from visible side to points, by tenth of the car's height", insets),
    ("points on cars by tenth of the height", body_heights),
    ("reflectance, quartiles: ground by range, cars, else low, else high", reflectances),
)


def draw(theirs: Collected, ours: Collected, path: Path) -> None:
    found = {}
    figure, axes = plt.subplots(6, 3, figsize=(17, 22))
    for axis, (title, measure) in zip(axes.ravel(), PANELS, strict=True):
        real, simulated = measure(theirs), measure(ours)
        axis.plot(real, "o-", color="black", markersize=3.5, linewidth=1, label="KITTI")
        axis.plot(
            simulated, "s-", color="tab:orange", markersize=3.5, linewidth=1, label="simulated"
        )
        axis.set_title(title, fontsize=9)
        axis.set_ylim(bottom=min(0, np.nanmin([real, simulated])))
        worst = int(np.nanargmax(np.abs(real - simulated)))
        print(
            f"{title}: largest difference at {worst}: "
            f"KITTI {real[worst]:.3f}, simulated {simulated[worst]:.3f}"
        )
        found[title] = {"KITTI": float(real[worst]), "simulated": float(simulated[worst])}
    axes[0, 0].legend()
    mean = [len(c.points) / c.n_frames for c in (theirs, ours)]
    cars = [len(of_cars(c)) / c.n_labelled for c in (theirs, ours)]
    figure.suptitle(
        f"{theirs.n_labelled} KITTI label files and {theirs.n_frames} clouds "
        f"against {ours.n_frames} simulated frames; "
        f"points in view {mean[0]:.0f} and {mean[1]:.0f}, "
        f"cars a frame {cars[0]:.1f} and {cars[1]:.1f}"
    )
    figure.tight_layout(rect=(0, 0, 1, 0.985))
    figure.savefig(path, dpi=70)
    print(f"written to {path}")
    tell("sim_statistics", found)


if __name__ == "__main__":
    main()
