"""Real results on KITTI's validation split: each AP of a comparison is the known one, and no 3D box has no 3D AP."""

import csv
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.compare import Compared, compare_detectors
from fl3d.analysis.compare_tables import text_of
from fl3d.analysis.detectors import Detector
from fl3d.analysis.result_folders import hold
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol

FLAT = "Car 0 0 -10 {box} -1 -1 -1 -1000 -1000 -1000 -10 {score}\n"
STRICT = {"Car": (0.7, 0.7, 0.7), "Pedestrian": (0.5, 0.5, 0.5), "Cyclist": (0.5, 0.5, 0.5)}


@pytest.fixture(scope="module")
def real(
    eval_cases: Path, kitti_sample: Path, tmp_path_factory: pytest.TempPathFactory
) -> Compared:
    """Point-GNN, a monocular detector of three classes, and a detector in the picture."""
    root = tmp_path_factory.mktemp("real")
    for name in ("pointgnn_val", "m3drpn_val"):
        with zipfile.ZipFile(eval_cases / name / "detections.zip") as archive:
            archive.extractall(root / name)
    folders = {
        "Point-GNN": next((root / "pointgnn_val").rglob("*.txt")).parent,
        "monocular": next((root / "m3drpn_val").rglob("*.txt")).parent,
        "2D": in_picture(kitti_sample, root / "rgb"),
    }
    detectors = [Detector(name, (folder,)) for name, folder in folders.items()]
    labels = kitti_sample / "training" / "label_2"
    held = hold(labels, detectors, Protocol("kitti", "B", STRICT, 0.0, 0.1, "standup", 1000))
    return compare_detectors(held, n_resamples=200)


def in_picture(kitti: Path, folder: Path) -> Path:
    """The 2D detections of cars as result files without a 3D box."""
    folder.mkdir()
    texts = dict.fromkeys(KittiFolder(kitti).split("val"), "")
    for line in (kitti / "rgb_detections" / "rgb_detection_val.txt").read_text().splitlines():
        path, kind, score, *box = line.split()
        if kind == "2":
            texts[Path(path).stem] += FLAT.format(box=" ".join(box), score=score)
    for frame, text in texts.items():
        (folder / f"{frame}.txt").write_text(text)
    return folder


def row(found: Compared, *key: str) -> pd.Series:
    columns = ("detector", "metric", "difficulty", "average")
    rows = found.cells
    for column, value in zip(columns, key, strict=True):
        rows = rows[rows[column] == value]
    assert len(rows) == 1
    return rows.iloc[0]


@pytest.mark.parametrize(("detector", "case"), [("Point-GNN", "pointgnn_val"), ("2D", "rgb2d_val")])
def test_aps_are_the_known_ones(real: Compared, eval_cases: Path, detector: str, case: str) -> None:
    with (eval_cases / case / "expected.csv").open() as file:
        for known in csv.DictReader(file):
            for average in ("R11", "R40"):
                for difficulty in DIFFICULTIES:
                    found = row(real, detector, known["metric"], difficulty, average)
                    assert f"{found['ap']:.4f}" == known[f"{average.lower()}_{difficulty}"]
                    assert str(found["n_gt"]) == known[f"n_gt_{difficulty}"]


def test_the_monocular_detector_is_behind_in_3d_and_drives_are_resampled(real: Compared) -> None:
    """APs as the project's own evaluator gave them when its bootstrap was measured."""
    found = row(real, "monocular", "3d", "moderate", "R40")
    assert f"{found['ap']:.2f}" == "48.29"
    assert f"{row(real, 'monocular', '3d', 'moderate', 'R11')['ap']:.2f}" == "50.53"
    assert found["gain"] == pytest.approx(48.2905 - 82.2971, abs=1e-4)
    assert found["gain_high"] < -20
    assert (real.held.units.name, real.held.units.count) == ("drives", 45)
    assert list(real.verdicts["verdict"]) == ["baseline", "none"]  # one run of each


def test_2d_boxes_have_no_3d_gain(real: Compared) -> None:
    for metric in ("bev", "3d"):
        found = row(real, "2D", metric, "moderate", "R40")
        assert np.isnan([found["ap"], found["gain"]]).all()
    assert row(real, "2D", "image", "moderate", "R40")["gain"] > 0
    assert "2D" not in set(real.verdicts["level"])
    assert (
        "| 2D        |    – | –                  | –                     | no 3D boxes"
        in text_of(real)
    )
    assert "2D has no bird's-eye and no 3D boxes of Car: no AP and no gain there." in real.notes
    of_cars = "has no detection of Pedestrian: no AP and no gain."
    assert f"Pedestrian is not compared. Point-GNN {of_cars} 2D {of_cars}" in real.notes
