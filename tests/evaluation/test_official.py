"""Real detections on the full validation split, to every printed digit of the official evaluator."""

import csv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import Labels, labels_from_columns, read_labels
from fl3d.evaluation.average_precision import evaluate
from fl3d.evaluation.protocol import Protocol

LEVELS = ("easy", "moderate", "hard")
STRICT = {"Car": (0.7, 0.7, 0.7)}


@pytest.fixture(scope="module")
def val(kitti_sample: Path) -> dict[str, Labels]:
    folder = KittiFolder(kitti_sample)
    return {frame_id: folder.read_labels(frame_id) for frame_id in folder.split("val")}


def protocol(variant: str) -> Protocol:
    return Protocol("official", variant, STRICT, 0.0, 0.1, "standup", 1000)


def check(case: Path, gt: list[Labels], det: list[Labels]) -> None:
    curves = evaluate(gt, det, protocol("B"))["Car"]
    with case.open() as file:
        for row in csv.DictReader(file):
            for level in LEVELS:
                found = curves[row["metric"]][level]
                assert found.n_gt == int(row[f"n_gt_{level}"])
                assert f"{found.ap_r11:.4f}" == row[f"r11_{level}"]
                assert f"{found.ap_r40:.4f}" == row[f"r40_{level}"]


def test_point_gnn(val: dict[str, Labels], eval_cases: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(eval_cases / "pointgnn_val" / "detections.zip") as archive:
        archive.extractall(tmp_path)
    files = {path.stem: path for path in tmp_path.rglob("*.txt")}
    det = [read_labels(files[frame_id], scored=True) for frame_id in val]
    check(eval_cases / "pointgnn_val" / "expected.csv", list(val.values()), det)


def test_rgb_detections(val: dict[str, Labels], eval_cases: Path, kitti_sample: Path) -> None:
    rows: dict[str, list[list[float]]] = {frame_id: [] for frame_id in val}
    for line in (kitti_sample / "rgb_detections" / "rgb_detection_val.txt").read_text().splitlines():
        path, kind, score, *box = line.split()
        if kind == "2":
            rows[Path(path).stem].append([0, 0, -10, *map(float, box), *[0.0] * 7, float(score)])
    det = [labels_from_columns(["Car"] * len(r), np.array(r).reshape(-1, 15), scored=True) for r in rows.values()]
    check(eval_cases / "rgb2d_val" / "expected.csv", list(val.values()), det)


def test_variants_count_their_ground_truths(val: dict[str, Labels]) -> None:
    nothing = [labels_from_columns([], np.zeros((0, 15)), scored=True) for _ in val]
    for variant, expected in (("A", [2907, 7876, 10963]), ("B", [2906, 7874, 10960])):
        curves = evaluate(list(val.values()), nothing, protocol(variant))["Car"]["3d"]
        assert [curves[level].n_gt for level in LEVELS] == expected
