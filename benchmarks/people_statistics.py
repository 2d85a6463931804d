"""How like KITTI's the simulated pedestrians and cyclists are: labels, points and 2D detections, side by side.

    python benchmarks/people_statistics.py --kitti FOLDER --frames FILE [--people 3] [--simulated 1200]

Labels are compared with all label files of FOLDER's train split, points with the clouds of the frames in FILE, 2D
detections with those of FOLDER's val split. Prints tables in Markdown: simulated | KITTI.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import Labels
from fl3d.data.splits import read_split
from fl3d.geometry.iou import image_iou
from fl3d.simulator.generate import Settings, generate
from fl3d.simulator.image_detector import NUMBERS

Float = NDArray[np.float64]
CLASSES = ("Pedestrian", "Cyclist", "Person_sitting")
LEVELS = ((40, 0, 0.15), (25, 1, 0.3), (25, 2, 0.5))  # KITTI's easy, moderate, hard
TOGETHER = 1.6  # metres between two who are of a group
BINS = ((5, 10), (10, 15), (15, 20), (20, 30), (30, 40), (40, 55))  # metres


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, required=True)
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--people", type=float, default=3.0, help="the rate (default: 3)")
    parser.add_argument("--simulated", type=int, default=1200, help="frames (default: 1200)")
    given = parser.parse_args()
    kitti = KittiFolder(given.kitti)
    with tempfile.TemporaryDirectory() as name:
        settings = Settings(given.simulated, 0, seed=1, people=given.people)
        ours = KittiFolder(generate(Path(name), settings))
        ids = ours.split("train")
        for kind in CLASSES:
            both = (Objects.of(ours, ids, kind), Objects.of(kitti, kitti.split("train"), kind))
            print(f"\n| {kind} | simulated | KITTI |\n|---|---|---|")
            for title, measure in ROWS:
                print(f"| {title} | {measure(both[0])} | {measure(both[1])} |")
            print_points(inside(ours, ids, kind), inside(kitti, read_split(given.frames), kind))
        print_detections(ours, ids, kitti, kitti.split("val"))


@dataclass
class Objects:
    """All objects of a class in some frames.

    Args:
        frame: (N,) number of the frame.
        boxes: (N, 7) x, y, z, h, w, l, yaw in the LiDAR frame.
        labels: (N,) their labels.
        n_frames: all frames, also those without any.
    """

    frame: NDArray[np.int64]
    boxes: Float
    labels: list[Labels]
    n_frames: int

    @classmethod
    def of(cls, folder: KittiFolder, ids: Sequence[str], kind: str) -> Objects:
        """Read them."""
        frames, boxes, labels = [], [], []
        for number, frame_id in enumerate(ids):
            own = folder.read_labels(frame_id)
            own = own.select(own.types == kind)
            boxes.append(folder.read_calibration(frame_id).boxes_to_velo(own.boxes_cam))
            frames += [number] * len(own)
            labels.append(own)
        return cls(np.array(frames), np.concatenate(boxes), labels, len(ids))

    def column(self, name: str) -> Float:
        """A column of the labels, of all objects."""
        return np.concatenate([getattr(own, name) for own in self.labels])

    @property
    def distance(self) -> Float:
        """Metres from the LiDAR."""
        return np.hypot(self.boxes[:, 0], self.boxes[:, 1])


def shares(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}".removeprefix("0") for value in values)


def quartiles(values: Float) -> str:
    return " / ".join(f"{value:.1f}" for value in np.quantile(values, [0.1, 0.25, 0.5, 0.75, 0.9]))


def spread(o: Objects) -> str:
    sizes = o.boxes[:, [3, 4, 5]]
    return ", ".join(
        f"{m:.2f} ± {s:.2f}" for m, s in zip(sizes.mean(axis=0), sizes.std(axis=0), strict=True)
    )


def headings(o: Objects) -> str:
    yaw = np.abs(np.rad2deg(o.boxes[:, 6])) % 180
    yaw = np.minimum(yaw, 180 - yaw)
    return shares([np.mean(yaw < 30), np.mean((yaw >= 30) & (yaw <= 60)), np.mean(yaw > 60)])


def lateral(o: Objects) -> str:
    edges = (0, 2, 4, 6, 8, 12, 99)
    return shares(np.histogram(np.abs(o.boxes[:, 1]), edges)[0] / len(o.boxes))


def levels(o: Objects) -> str:
    edges = o.column("boxes_image")
    height, occluded, truncated = edges[:, 3] - edges[:, 1], *_state(o)
    return shares(
        [np.mean((height >= h) & (occluded <= c) & (truncated <= t)) for h, c, t in LEVELS]
    )


def _state(o: Objects) -> tuple[Float, Float]:
    return o.column("occluded"), o.column("truncated")


def occlusion(o: Objects) -> str:
    return shares([float(np.mean(o.column("occluded") == k)) for k in range(4)])


def together(o: Objects) -> str:
    found = 0
    for number in np.unique(o.frame):
        own = o.boxes[o.frame == number, :2]
        apart = np.linalg.norm(own[:, None] - own[None], axis=2) + 99 * np.eye(len(own))
        found += int((apart.min(axis=1) < TOGETHER).sum())
    return shares([found / len(o.boxes)])


ROWS: tuple[tuple[str, Callable[[Objects], str]], ...] = (
    ("objects, frames", lambda o: f"{len(o.boxes)}, {o.n_frames}"),
    ("objects a frame", lambda o: f"{len(o.boxes) / o.n_frames:.2f}"),
    ("frames with any", lambda o: shares([len(np.unique(o.frame)) / o.n_frames])),
    (
        "objects a frame that has any",
        lambda o: f"{len(o.boxes) / len(np.unique(o.frame)):.2f}",
    ),
    ("height, width, length, m", spread),
    ("distance, m: 10, 25, 50, 75, 90 %", lambda o: quartiles(o.distance)),
    ("beside the axis by 0–2 / –4 / –6 / –8 / –12 / more, m", lateral),
    ("on the left", lambda o: shares([float(np.mean(o.boxes[:, 1] > 0))])),
    ("heading along the axis / oblique / across", headings),
    ("occlusion 0 / 1 / 2 / 3", occlusion),
    ("truncated", lambda o: shares([float(np.mean(o.column("truncated") > 0))])),
    ("easy / moderate / hard", levels),
    (f"with another within {TOGETHER} m", together),
)


def inside(folder: KittiFolder, ids: Sequence[str], kind: str) -> Float:
    """How points lie in boxes, (N, 7); NaN where there is nothing to measure.

    Distance, whether wholly visible, points inside, metres from the ground to the box and from the highest point to the
    box's top, mean reflectance, and share of points without any.
    """
    found = []
    for frame_id in ids:
        labels = folder.read_labels(frame_id)
        if not (labels.types == kind).any():
            continue
        frame = folder.frame(frame_id)
        labels = labels.select(labels.types == kind)
        points = frame.points_velo.astype(np.float64)
        for k, (x, y, z, h, w, length, yaw) in enumerate(
            frame.calibration.boxes_to_velo(labels.boxes_cam)
        ):
            q = points[:, :3] - (x, y, z)
            u, v = (
                q[:, 0] * np.cos(yaw) + q[:, 1] * np.sin(yaw),
                q[:, 1] * np.cos(yaw) - q[:, 0] * np.sin(yaw),
            )
            over = (np.abs(u) < length / 2) & (np.abs(v) < w / 2)
            own = over & (q[:, 2] > 0) & (q[:, 2] < h)
            around = ~over & (np.hypot(u, v) < 1.5) & (np.abs(q[:, 2]) < 0.4)
            low = np.median(q[around, 2]) if around.sum() >= 8 else np.nan
            ground = -np.median(q[around & (q[:, 2] <= low), 2]) if np.isfinite(low) else np.nan
            visible = labels.occluded[k] == 0 and labels.truncated[k] == 0
            shine = points[own, 3] if own.any() else np.array([np.nan])
            top = h - q[own, 2].max() if own.sum() >= 50 else np.nan
            row = (
                np.hypot(x, y),
                visible,
                own.sum(),
                ground,
                top,
                shine.mean(),
                np.mean(shine == 0),
            )
            found.append(row)
    return np.array(found).reshape(-1, 7)


def print_points(ours: Float, theirs: Float) -> None:
    """Points of those that are wholly visible, as if 10 m away, and how boxes and points lie."""
    for low, high in BINS:
        cells = []
        for rows in (ours, theirs):
            own = rows[(rows[:, 1] == 1) & (rows[:, 0] >= low) & (rows[:, 0] < high)]
            scaled = own[:, 2] * (own[:, 0] / 10) ** 2
            cells.append(f"{np.median(scaled):.0f} (of {len(own)})" if len(own) else "(none)")
        print(
            f"| points · (distance / 10 m)² at {low} to {high} m, median | {cells[0]} | {cells[1]} |"
        )
    for title, column, reach in (
        ("ground to the box's bottom, cm, to 25 m: 25, 50, 75 %", 3, 25),
        ("highest point to the box's top, cm, to 12 m: 25, 50, 75 %", 4, 12),
    ):
        cells = []
        for rows in (ours, theirs):
            own = rows[(rows[:, 1] == 1) & (rows[:, 0] < reach), column] * 100
            own = own[np.isfinite(own)]
            values = np.quantile(own, [0.25, 0.5, 0.75]) if len(own) else []
            cells.append(f"{' / '.join(f'{v:.0f}' for v in values)} (of {len(own)})")
        print(f"| {title} | {cells[0]} | {cells[1]} |")
    for low, high in ((0, 20), (20, 50)):
        cells = []
        for rows in (ours, theirs):
            own = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
            cells.append(shares(np.nanmean(own[:, 5:7], axis=0).tolist()) if len(own) else "(none)")
        print(f"| reflectance, share without any, {low} to {high} m | {cells[0]} | {cells[1]} |")


def detections(folder: KittiFolder, split: str) -> dict[str, list[tuple[str, float, Float]]]:
    """Class, score and box of the 2D detections, by frame."""
    names = {number: name for name, number in NUMBERS.items()}
    found: dict[str, list[tuple[str, float, Float]]] = {}
    path = folder.root / "rgb_detections" / f"rgb_detection_{split}.txt"
    for line in path.read_text(encoding="utf-8").splitlines():
        picture, number, score, *edges = line.split()
        box = np.array([float(edge) for edge in edges])
        found.setdefault(Path(picture).stem, []).append((names[int(number)], float(score), box))
    return found


def print_detections(
    ours: KittiFolder, own_ids: Sequence[str], kitti: KittiFolder, ids: Sequence[str]
) -> None:
    """Recall of easy, moderate and hard at overlap 0.5, and boxes a frame that meet nothing, by class and score."""
    print("\n| 2D detections | simulated | KITTI (val) |\n|---|---|---|")
    for kind in ("Car", "Pedestrian", "Cyclist"):
        for score in (0.1, 0.5, 0.9):
            mine = _found(ours, own_ids, "train", kind, score)
            theirs = _found(kitti, ids, "val", kind, score)
            print(
                f"| {kind}, score from {score}: recall easy / moderate / hard; false a frame | {mine} | {theirs} |"
            )


def _found(folder: KittiFolder, ids: Sequence[str], split: str, kind: str, score: float) -> str:
    boxes_of, hits, total, false = detections(folder, split), np.zeros(3), np.zeros(3), 0
    for frame_id in ids:
        labels = folder.read_labels(frame_id)
        own = labels.select(labels.types == kind)
        boxes = np.array([b for k, s, b in boxes_of.get(frame_id, []) if k == kind and s >= score])
        boxes = boxes.reshape(-1, 4)
        false += int((image_iou(boxes, labels.boxes_image).max(axis=1, initial=0) < 0.1).sum())
        hit = image_iou(own.boxes_image, boxes).max(axis=1, initial=0) >= 0.5
        height = own.boxes_image[:, 3] - own.boxes_image[:, 1]
        for k, (h, c, t) in enumerate(LEVELS):
            counted = (height >= h) & (own.occluded <= c) & (own.truncated <= t)
            hits[k] += hit[counted].sum()
            total[k] += counted.sum()
    return f"{shares((hits / np.maximum(total, 1)).tolist())}; {false / len(ids):.2f}"


if __name__ == "__main__":
    main()
