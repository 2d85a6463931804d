"""How long an evaluation takes, from text files: ours beside mmdet3d's, which many use.

    python benchmarks/evaluator.py                       # 3769 made-up frames, three classes
    python benchmarks/evaluator.py --labels training/label_2 --results my/results

mmdet3d's evaluator comes from its wheel (pip download, nothing is installed). Its rotated overlap
runs on CUDA only; it is given a CPU one (ours), so it is timed on all but that. It is handed parsed
annotations; ours reads the text files too. Times are CPU seconds of one process after compilation;
the best of three.
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
import tempfile
import time
import types
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.data.label_table import NAMES, LabelTable, read_table
from fl3d.data.label_table import OTHER as OTHER_TYPE
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.bootstrap import N_RESAMPLES, resampled_aps, unit_weights
from fl3d.evaluation.folders import evaluate_folder, result_ids
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol
from fl3d.geometry.iou import bev_iou, intersection_areas

OTHER = "mmdet3d==1.4.0"
KINDS = ["Car", "Car", "Car", "Van", "Pedestrian", "Cyclist"]
SIZES = {
    "Car": (1.5, 1.6, 3.9),
    "Van": (2.2, 1.9, 5.0),
    "Pedestrian": (1.7, 0.6, 0.8),
    "Cyclist": (1.7, 0.6, 1.8),
}


def make_folders(root: Path, n_frames: int) -> tuple[Path, Path]:
    """Frames with seven objects and ten detections on average."""
    rng = np.random.default_rng(0)
    labels, results = root / "labels", root / "results"
    labels.mkdir()
    results.mkdir()
    for i in range(n_frames):
        gt, det = [], []
        for _ in range(rng.poisson(7)):
            kind = str(rng.choice(KINDS))
            x, z, ry = rng.uniform(-20, 20), rng.uniform(5, 60), rng.normal(0, 1)
            gt.append(line(kind, int(rng.integers(0, 3)), x, z, ry, 0.0, rng, ""))
            if kind != "Van" and rng.random() < 0.85:
                det.append(line(kind, 0, x, z, ry, 0.15, rng, f" {rng.random():.9f}"))
        for _ in range(rng.poisson(4)):
            kind = str(rng.choice(KINDS[2:]))
            if kind != "Van":
                x, z = rng.uniform(-20, 20), rng.uniform(5, 60)
                det.append(line(kind, 0, x, z, 0.0, 0.0, rng, f" {rng.random() * 0.6:.9f}"))
        (labels / f"{i:06d}.txt").write_text("".join(gt))
        (results / f"{i:06d}.txt").write_text("".join(det))
    return labels, results


def line(
    kind: str,
    occluded: int,
    x: float,
    z: float,
    ry: float,
    noise: float,
    rng: np.random.Generator,
    end: str,
) -> str:
    h, w, length = (v * (1 + rng.normal(0, noise / 3)) for v in SIZES[kind])
    x, z = x + rng.normal(0, noise), z + rng.normal(0, noise)
    height = 720 * h / z
    u = 610 + 720 * x / z
    box = f"{u - height:.2f} {180 - height / 2:.2f} {u + height:.2f} {180 + height / 2:.2f}"
    size = f"{h:.2f} {w:.2f} {length:.2f}"
    return f"{kind} 0.00 {occluded} 0.50 {box} {size} {x:.2f} 1.70 {z:.2f} {ry:.2f}{end}\n"


def load_other(folder: Path) -> types.ModuleType:
    """mmdet3d's evaluator alone, with a CPU overlap in the place of its CUDA one."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), OTHER]
    subprocess.run(command, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        for name in wheel.namelist():
            if "kitti_utils/" in name:
                (folder / "kitti_utils").mkdir(exist_ok=True)
                (folder / "kitti_utils" / Path(name).name).write_bytes(wheel.read(name))
    (folder / "kitti_utils" / "__init__.py").write_text("")
    substitute = types.ModuleType("kitti_utils.rotate_iou")

    def rotate_iou(boxes: np.ndarray, query: np.ndarray, criterion: int = -1) -> np.ndarray:
        return (bev_iou if criterion == -1 else intersection_areas)(boxes, query)

    substitute.rotate_iou_gpu_eval = rotate_iou  # type: ignore[attr-defined]
    sys.modules["kitti_utils.rotate_iou"] = substitute
    sys.path.insert(0, str(folder))
    return importlib.import_module("kitti_utils.eval")


def annotations(table: LabelTable) -> list[dict[str, np.ndarray]]:
    """Frames as mmdet3d wants them."""
    proper = np.array(
        [
            "Car",
            "Van",
            "Truck",
            "Pedestrian",
            "Person_sitting",
            "Cyclist",
            "Tram",
            "Misc",
            "DontCare",
            "?",
        ]
    )
    assert len(proper) == len(NAMES) + 1
    frames = []
    for first, last in zip(table.offsets[:-1], table.offsets[1:], strict=True):
        v = table.values[first:last]
        frames.append(
            {
                "name": proper[np.minimum(table.types[first:last], OTHER_TYPE)],
                "truncated": v[:, 0],
                "occluded": v[:, 1],
                "alpha": v[:, 2],
                "bbox": v[:, 3:7],
                "dimensions": v[:, [9, 7, 8]],  # l, h, w
                "location": v[:, 10:13],
                "rotation_y": v[:, 13],
                "score": v[:, 14],
            }
        )
    return frames


def best(work: Callable[[], object], times: int = 3) -> float:
    seconds = []
    for _ in range(times):
        started = time.process_time()
        work()
        seconds.append(time.process_time() - started)
    return min(seconds)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--labels", type=Path)
    parser.add_argument("--results", type=Path)
    parser.add_argument(
        "--frames", type=int, default=3769, help="made-up frames, where no folders are given"
    )
    parser.add_argument(
        "--without-other", dest="other", action="store_false", help="mmdet3d is not downloaded"
    )
    options = parser.parse_args()
    warnings.filterwarnings("ignore")
    with tempfile.TemporaryDirectory() as folder:
        labels, results = options.labels, options.results
        if labels is None:
            labels, results = make_folders(Path(folder), options.frames)
        protocol = Protocol(**compose_config(["protocol=kitti", "profile=paper"])["protocol"])
        evaluate_folder(labels, results, protocol)  # compile
        ours = best(lambda: evaluate_folder(labels, results, protocol))
        ids = result_ids(results)
        gt, det = read_table(labels, ids, scored=False), read_table(results, ids, scored=True)
        core = best(lambda: evaluate(compare(gt, det, protocol)))
        print(f"{len(ids)} frames, 3 classes x 3 metrics x 3 levels, CPU seconds")
        print(
            f"fl3d, text files to curves      {ours:8.3f}   "
            f"(reading {ours - core:.3f}, evaluating {core:.3f})"
        )
        found = {"seconds": ours, "reading": ours - core}
        found |= {"mmdet3d / fl3d": beside(Path(folder), gt, det, ours)} if options.other else {}
        found |= {"resampling s": resampling(gt, det, protocol)}
    tell("evaluator", found)


def beside(folder: Path, gt: LabelTable, det: LabelTable, ours: float) -> float:
    """How many times as long mmdet3d takes."""
    other = load_other(folder)
    gt_frames, det_frames = annotations(gt), annotations(det)
    classes = ["Car", "Pedestrian", "Cyclist"]

    def theirs() -> object:
        return other.kitti_eval(gt_frames, det_frames, classes, eval_types=["bbox", "bev", "3d"])

    theirs()  # compile
    seconds = best(theirs, 1)
    print(
        f"mmdet3d 1.4.0, without reading  {seconds:8.3f}   {seconds / ours:.0f} x fl3d with reading"
    )
    print("(mmdet3d looks at two sets of overlaps in one call; per set about half)")
    return seconds / ours


def resampling(gt: LabelTable, det: LabelTable, protocol: Protocol) -> float:
    """Seconds of resampling nine APs of two detectors."""
    shaken = LabelTable(det.offsets, det.types, det.values.copy())
    shaken.values[:, 14] += np.random.default_rng(0).normal(0, 0.02, len(det.types))
    sides = [compare(gt, d, protocol) for d in (det, shaken)]
    pairs = [[side.matches("Car", m, d) for side in sides] for m in METRICS for d in DIFFICULTIES]
    weights = unit_weights(len(gt), N_RESAMPLES)
    resampled_aps(pairs[0][0], weights[:2])  # compile
    taken = best(lambda: [resampled_aps(one, weights) for two in pairs for one in two], 1)
    print(f"{N_RESAMPLES} resamples of 9 APs of two detectors, Car  {taken:.3f}")
    return taken


if __name__ == "__main__":
    main()
