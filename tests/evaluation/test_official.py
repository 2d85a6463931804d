"""Real detections on the full validation split, to every printed digit of the official evaluator."""

import csv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import LabelTable, read_table, table_from_labels
from fl3d.data.labels import labels_from_columns, read_labels
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.protocol import Protocol

LEVELS = ("easy", "moderate", "hard")
STRICT = {"Car": (0.7, 0.7, 0.7)}


@pytest.fixture(scope="module")
def ids(kitti_sample: Path) -> list[str]:
    return KittiFolder(kitti_sample).split("val")


@pytest.fixture(scope="module")
def val(kitti_sample: Path, ids: list[str]) -> LabelTable:
    return read_table(kitti_sample / "training" / "label_2", ids, scored=False)


def protocol(variant: str) -> Protocol:
    return Protocol("official", variant, STRICT, 0.0, 0.1, "standup", 1000)


def check(case: Path, gt: LabelTable, det: LabelTable) -> None:
    curves = evaluate(compare(gt, det, protocol("B")))["Car"]
    with case.open() as file:
        for row in csv.DictReader(file):
            for level in LEVELS:
                found = curves[row["metric"]][level]
                assert found.n_gt == int(row[f"n_gt_{level}"])
                assert f"{found.ap_r11:.4f}" == row[f"r11_{level}"]
                assert f"{found.ap_r40:.4f}" == row[f"r40_{level}"]


def test_point_gnn(val: LabelTable, ids: list[str], eval_cases: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(eval_cases / "pointgnn_val" / "detections.zip") as archive:
        archive.extractall(tmp_path)
    folder = next(tmp_path.rglob("*.txt")).parent
    check(eval_cases / "pointgnn_val" / "expected.csv", val, read_table(folder, ids, scored=True))


def test_rgb_detections(
    val: LabelTable, ids: list[str], eval_cases: Path, kitti_sample: Path
) -> None:
    rows: dict[str, list[list[float]]] = {frame_id: [] for frame_id in ids}
    for line in (
        (kitti_sample / "rgb_detections" / "rgb_detection_val.txt").read_text().splitlines()
    ):
        path, kind, score, *box = line.split()
        if kind == "2":
            rows[Path(path).stem].append([0, 0, -10, *map(float, box), *[0.0] * 7, float(score)])
    frames = [
        labels_from_columns(["Car"] * len(r), np.array(r).reshape(-1, 15), scored=True)
        for r in rows.values()
    ]
    check(eval_cases / "rgb2d_val" / "expected.csv", val, table_from_labels(frames))


def test_variants_count_their_ground_truths(val: LabelTable) -> None:
    nothing = LabelTable(
        np.zeros(len(val) + 1, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 15))
    )
    for variant, expected in (("A", [2907, 7876, 10963]), ("B", [2906, 7874, 10960])):
        curves = evaluate(compare(val, nothing, protocol(variant)))["Car"]["3d"]
        assert [curves[level].n_gt for level in LEVELS] == expected


def test_the_fast_reader_reads_what_the_plain_one_does(
    val: LabelTable, ids: list[str], kitti_sample: Path
) -> None:
    plain = table_from_labels(
        [read_labels(kitti_sample / "training" / "label_2" / f"{i}.txt") for i in ids]
    )
    np.testing.assert_array_equal(val.offsets, plain.offsets)
    np.testing.assert_array_equal(val.types, plain.types)
    np.testing.assert_array_equal(val.values, plain.values)
