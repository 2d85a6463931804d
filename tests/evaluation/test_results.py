"""Result files as stored detections: their numbers stay, and so does their AP."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.core.errors import DataError
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.folders import evaluate_folder
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.results import read_results, results_digest, write_results
from fl3d.evaluation.scoring import score
from fl3d.evaluation.validation import read_validation
from tests.example_program import results

NAMES = {"ap_r11": "ap_{}/{}", "ap_r40": "ap_{}_r40/{}"}


def protocol(name: str) -> Protocol:
    return read_settings(compose_config([f"protocol={name}", "profile=paper"])).protocol


@pytest.fixture
def folder(simulated: Path, tmp_path: Path) -> Path:
    """Result files of all frames, in an order of their own; the second is empty."""
    ids = KittiFolder(simulated).split("val")
    for i, name in enumerate(ids):
        labels = (simulated / "training" / "label_2" / f"{name}.txt").read_text().splitlines()
        text = results(labels, 0.3, name) if i != 1 else ""
        (tmp_path / f"{name}.txt").write_text(
            text + "Van -1 -1 0.1 1 2 30 40 1 1 1 0 0 9 0 12.5\n" * (i == 0)
        )
    return tmp_path


@pytest.mark.parametrize("name", ["kitti", "kitti_loose", "paper_strict"])
def test_their_ap_is_that_of_evaluate_to_the_bit(simulated: Path, folder: Path, name: str) -> None:
    kitti = KittiFolder(simulated)
    ids = kitti.split("val")[::-1]
    rules = replace(protocol(name), score_threshold=0.0)
    write_results(folder / "stored.parquet", read_results(folder, ids))
    stored = read_detections(folder / "stored.parquet")
    found = score(stored, read_validation(kitti, ids), rules)
    curves = evaluate_folder(simulated / "training" / "label_2", folder, rules).curves
    values = []
    for metric, levels in curves["Car"].items():
        for level, curve in levels.items():
            assert found[f"ap_{metric}/{level}"] == curve.ap_r11
            assert found[f"ap_{metric}_r40/{level}"] == curve.ap_r40
            values.append(curve.ap_r40)
    assert max(values) > 0
    assert found["recall_3d/0.1"] >= 0.5  # one frame of four is empty


def test_a_score_cut_above_zero_is_made_and_suppression_never(
    simulated: Path, folder: Path
) -> None:
    ids = KittiFolder(simulated).split("val")
    found = read_results(folder, ids)
    kitti = KittiFolder(simulated)
    places = [kitti.read_calibration(i) for i in ids], [kitti.image_size(i) for i in ids]
    whole = found.table(*places, replace(protocol("kitti"), nms_iou=0.0, max_detections=1))
    assert np.array_equal(whole.values, found.lines.values)
    cut = found.table(*places, replace(protocol("kitti"), score_threshold=0.7))
    assert np.array_equal(cut.values, found.lines.values[found.lines.scores >= 0.7])
    assert np.array_equal(cut.frame, found.lines.frame[found.lines.scores >= 0.7])


def test_a_frames_cars_come_best_first_and_without_other_classes(
    simulated: Path, folder: Path
) -> None:
    kitti = KittiFolder(simulated)
    ids = kitti.split("val")
    found = read_results(folder, ids)
    labels = found.labels_of(
        0, kitti.read_calibration(ids[0]), kitti.image_size(ids[0]), protocol("kitti")
    )
    assert labels.scores is not None
    assert set(labels.types) <= {"Car"}
    assert list(labels.scores) == sorted(labels.scores, reverse=True)
    assert 12.5 not in labels.scores


def test_results_without_any_car_are_refused_by_what_they_hold(
    simulated: Path, folder: Path
) -> None:
    ids = KittiFolder(simulated).split("val")
    for name in ids:
        path = folder / f"{name}.txt"
        path.write_text(path.read_text().replace("Car", "vehicle"))
    with pytest.raises(DataError, match=r"no Car among them; its types are: .*vehicle"):
        read_results(folder, ids)
    for name in ids:
        path = folder / f"{name}.txt"
        path.write_text(path.read_text().replace("vehicle", "Pedestrian"))
    assert (
        read_results(folder, ids).lines.others == ()
    )  # a detector of several classes that found no car yet


def test_a_digest_knows_names_and_bytes_and_no_order(simulated: Path, folder: Path) -> None:
    ids = KittiFolder(simulated).split("val")
    before = results_digest(folder, ids)
    assert results_digest(folder, ids[::-1]) == before
    (folder / f"{ids[1]}.txt").write_text("\n")
    assert results_digest(folder, ids) != before
