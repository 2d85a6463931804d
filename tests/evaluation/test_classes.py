"""Scores of any class, and of several: expected values are by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError
from fl3d.data.calibration import MEAN
from fl3d.data.classes import class_of, why_no_classes
from fl3d.data.label_table import table_from_labels
from fl3d.data.labels import Labels
from fl3d.evaluation import MEANS, VERSION
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.detections import Detections, read_detections, to_labels, write_detections
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.scoring import score
from fl3d.evaluation.validation import Validation

SIZE = (1242, 375)
OVERLAPS = {"Car": (0.7, 0.5, 0.5), "Pedestrian": (0.5, 0.25, 0.25), "Cone": (0.5, 0.25, 0.25)}
# Ten cars and ten cones in a row each, 4 m apart, 20 m away: near enough to be high in the picture.
CARS = np.array([[20.0, 4.0 * k, -1.7, 1.5, 1.6, 3.9, 0.0] for k in range(-2, 3)])
CONES = CARS + [6.0, 0, 0, 1.5, -0.8, -3.0, 0]


def protocol(*classes: str, **more: object) -> Protocol:
    values = {"variant": "A", "score_threshold": 0.0, "nms_iou": 0.1, "nms_kind": "rotated"}
    rest = {"max_detections": 100, "difficulty": "none", "overlaps": OVERLAPS}
    return Protocol(name="test", classes=classes, **{**values, **rest, **more})


def labels(boxes_velo: np.ndarray, types: list[str]) -> Labels:
    n = len(types)
    zeros = np.zeros(n)
    boxes_cam = MEAN.boxes_to_cam(boxes_velo)
    whole = np.zeros(n, dtype=np.int64)
    return Labels(np.array(types), zeros, whole, zeros, np.zeros((n, 4)), boxes_cam)


@pytest.fixture
def validation() -> Validation:
    truth = labels(np.concatenate([CARS, CONES]), ["Car"] * 5 + ["Cone"] * 5)
    return Validation(("0",), (truth,), (MEAN,), (SIZE,))


def detections(boxes: np.ndarray, types: list[str] | None) -> Detections:
    n = len(boxes)
    named = None if types is None else np.array(types)
    scores = np.linspace(0.9, 0.5, n)
    return Detections(("0",), np.zeros(n, np.int64), boxes, scores, None, named)


def test_several_classes_have_scores_each_and_their_mean(validation: Validation) -> None:
    """All cars are found and no cone, so that cars have an AP of 5 hits of 5, cones 0, and the mean is half."""
    found = detections(CARS, ["Car"] * 5)
    both = score(found, validation, protocol("Car", "Cone"))
    alone = score(found, validation, protocol("Car"))
    assert alone["ap_3d/moderate"] > 0
    assert both["ap_3d/moderate/Car"] == alone["ap_3d/moderate"]
    assert both["ap_3d/moderate/Cone"] == 0
    assert both["ap_3d/moderate"] == alone["ap_3d/moderate"] / 2
    assert both["recall_3d/0.5/Car"] == 1
    assert both["recall_3d/0.5/Cone"] == 0
    assert both["recall_3d/0.5"] == 0.5
    assert set(protocol("Car", "Cone").metric_names) <= set(both)


def test_a_class_without_ground_truths_has_no_part_in_a_mean() -> None:
    """Of cars alone in the frames: the mean over cars and cones is the cars', and not half of it."""
    truth = labels(CARS, ["Car"] * 5)
    cars = Validation(("0",), (truth,), (MEAN,), (SIZE,))
    both = score(detections(CARS, ["Car"] * 5), cars, protocol("Car", "Cone"))
    assert both["ap_3d/moderate"] == both["ap_3d/moderate/Car"] > 0
    assert both["recall_3d/0.5"] == both["recall_3d/0.5/Car"] == 1
    assert both["ap_3d/moderate/Cone"] == both["recall_3d/0.5/Cone"] == 0
    nothing = score(detections(CARS, ["Car"] * 5), cars, protocol("Cone"))
    assert nothing["ap_3d/moderate"] == 0


def test_scores_of_one_class_keep_their_identity() -> None:
    """What a mean is over has changed, and one class has none: its scores are as they were."""
    one, two = protocol("Car"), protocol("Car", "Cone")
    assert one.id == f"test-{digest([VERSION, one._values()])[:8]}"
    assert two.id == f"test-{digest([VERSION, MEANS, two._values()])[:8]}"


def test_one_class_has_the_names_that_cars_have(validation: Validation) -> None:
    cones = score(detections(CONES, ["Cone"] * 5), validation, protocol("Cone"))
    cars = score(detections(CARS, None), validation, protocol("Car"))
    assert cones == pytest.approx(cars)


def test_a_box_of_another_class_is_no_hit(validation: Validation) -> None:
    called_cars = score(detections(CONES, ["Car"] * 5), validation, protocol("Cone"))
    assert called_cars["ap_3d/moderate"] == 0
    assert called_cars["recall_3d/0.1"] == 0


def test_files_without_classes_are_of_cars_and_others_name_theirs(tmp_path: Path) -> None:
    write_detections(tmp_path / "cars.parquet", detections(CARS, None))
    cars = read_detections(tmp_path / "cars.parquet")
    assert len(cars.boxes_of(0, "Car", MEAN)) == 5
    assert len(cars.boxes_of(0, "Cone", MEAN)) == 0
    mixed = detections(CARS, ["Car", "Cone", "Car", "Cone", "Cone"])
    write_detections(tmp_path / "mixed.parquet", mixed)
    found = read_detections(tmp_path / "mixed.parquet")
    np.testing.assert_array_equal(found.boxes_of(0, "Cone", MEAN), CARS[[1, 3, 4]])


def test_each_class_is_suppressed_by_itself() -> None:
    """Two boxes in one place: of one class the better one stays, of two classes both do."""
    boxes, scores = np.repeat(CARS[:1], 2, axis=0), np.array([0.6, 0.9])
    rule = protocol("Car", "Cone")
    same = to_labels(boxes, scores, None, MEAN, SIZE, rule, np.array(["Cone", "Cone"]))
    other = to_labels(boxes, scores, None, MEAN, SIZE, rule, np.array(["Cone", "Car"]))
    assert same.scores is not None
    assert other.scores is not None
    assert (same.types.tolist(), same.scores.tolist()) == (["Cone"], [0.9])
    assert (other.types.tolist(), other.scores.tolist()) == (["Car", "Cone"], [0.9, 0.6])


def test_neighbours_of_ones_own_are_neither_hits_nor_misses() -> None:
    """Five cones found and five posts: false alarms, unless posts are neighbours of cones."""
    truth = labels(np.concatenate([CARS, CONES]), ["Post"] * 5 + ["Cone"] * 5)
    found = replace(
        labels(np.concatenate([CARS, CONES]), ["Cone"] * 10), scores=np.linspace(0.9, 0.1, 10)
    )
    strict, lenient = protocol("Cone"), protocol("Cone", neighbours={"Cone": ["Post"]})
    curves = [
        evaluate(
            compare(table_from_labels([truth]), table_from_labels([found]), rule), rule.classes
        )["Cone"]["3d"]["moderate"]
        for rule in (strict, lenient)
    ]
    assert [int(curve.fp[-1]) for curve in curves] == [5, 0]
    assert [int(curve.tp[-1]) for curve in curves] == [5, 5]


def test_kittis_neighbours_are_vans_and_sitting_people() -> None:
    plain = protocol("Car")
    assert plain.neighbours_of("car") == ("Van",)
    assert plain.neighbours_of("Pedestrian") == ("Person_sitting",)
    assert plain.neighbours_of("Cone") == ()
    assert protocol("Car", neighbours={"Car": []}).neighbours_of("Car") == ()


@pytest.mark.parametrize(
    ("classes", "why"),
    [
        (["Car"], ""),
        (["Truck", "Cone"], ""),
        ([], "is no list of names"),
        ("Car", "is no list of names"),
        (["Car", "Car"], "names Car twice"),
        (["pedestrian"], "which KITTI spells Pedestrian"),
        (["DontCare"], "is no class"),
        (["Traffic Cone"], "holds a blank"),
        (["Cone.red"], "holds a dot"),
        ([None], "names no class"),
    ],
)
def test_what_classes_may_be(classes: object, why: str) -> None:
    found = why_no_classes(classes)
    assert why in found
    assert bool(why) == bool(found)


def test_a_type_of_labels_is_learnt_as_one_class() -> None:
    two = ("Car", "Pedestrian")
    assert [class_of(label, two) for label in ("Car", "Pedestrian", "Van", "Truck")] == [
        *(0, 1, 0, None)
    ]
    assert class_of("Truck", ("Car",)) == 0  # with one class whatever `targets` names is of it


def settings(*words: str) -> object:
    return read_settings(compose_config(list(words)))


def test_classes_that_the_protocol_does_not_know_name_the_key() -> None:
    with pytest.raises(ConfigError, match=r"give \+protocol\.overlaps\.Cone="):
        settings("classes=[Car,Cone]")
    found = settings("classes=[Car,Cone]", "+protocol.overlaps.Cone=[0.5,0.25,0.25]")
    assert found.protocol.classes == ("Car", "Cone")
    with pytest.raises(ConfigError, match=r"classes: '.*' is not a list of names"):
        settings("classes=[car]")


def test_the_primary_metric_may_name_a_class() -> None:
    words = ("classes=[Car,Pedestrian]", "sweep.primary=3d_r40/moderate/Pedestrian")
    found = settings(*words).sweep
    assert (found.metric, found.average, found.class_name) == ("3d/moderate", "R40", "Pedestrian")
    for primary in ("3d_r40/moderate/Cyclist", "3d/far"):
        with pytest.raises(ConfigError, match="no metric"):
            settings(words[0], f"sweep.primary={primary}")


def test_protocols_of_other_classes_have_ids_of_their_own() -> None:
    ids = {settings(f"classes=[{one}]").protocol.id for one in ("Car", "Pedestrian", "Cyclist")}
    assert len(ids) == 3
    assert settings().protocol.id in ids


def test_papers_tables_are_of_cars() -> None:
    assert settings("+sweep=gamma").sweep.tables
    assert settings("+sweep=gamma", "classes=[Pedestrian]").sweep.tables == ()
