"""What counts and why the rest does not: each object once at each level, and as the evaluator counts it."""

import numpy as np
import pytest

from fl3d.core.errors import ConfigError
from fl3d.data.label_table import table_from_labels
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.counts import count_labels, count_results
from fl3d.evaluation.levels import Reason
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol

CAR = {"Car": (0.7, 0.7, 0.7)}
KITTI = Protocol("kitti", "B", {**CAR, "Pedestrian": (0.5, 0.5, 0.5)}, 0.0, 0.1, "standup", 100)


def protocol(**changes: object) -> Protocol:
    return Protocol("test", "B", CAR, 0.0, 0.1, "standup", 100, **changes)  # type: ignore[arg-type]


def thing(
    kind: str = "Car", height: float = 50, occluded: float = 0, truncated: float = 0, z: float = 20
) -> tuple[str, list[float]]:
    box = [100.0, 100.0, 180.0, 100.0 + height]
    return kind, [truncated, occluded, 0.0, *box, 1.5, 1.6, 4.0, 0.0, 1.7, z, 0.0]


def frame(*things: tuple[str, list[float]]) -> Labels:
    rows = np.array([row for _, row in things]).reshape(-1, 14)
    return labels_from_columns([kind for kind, _ in things], rows, scored=False)


def nothing() -> Labels:
    return labels_from_columns([], np.zeros((0, 15)), scored=True)


MIXED = frame(
    thing(),
    thing(height=30),  # below 40 px
    thing(height=0),
    thing(occluded=2),  # hard alone
    thing(occluded=4),
    thing(truncated=0.4),  # hard alone
    thing(truncated=1.5),
    thing(height=20, occluded=3),  # two reasons: the first counts
    thing("Van"),
    thing("Truck"),
    thing("Vehicle"),
    thing("Vehicle"),
    thing("DontCare"),
    thing("Pedestrian"),
)


def test_each_label_is_counted_once_with_its_reason() -> None:
    counts = count_labels([MIXED], KITTI)
    assert (counts.n_frames, counts.n_labels) == (1, 14)
    assert counts.labels == {"Car": 8, "Pedestrian": 1}
    assert counts.counted["Car"] == {"easy": 1, "moderate": 2, "hard": 4}
    assert counts.ignored["Car"]["easy"] == {
        Reason.NO_BOX: 1,
        Reason.LOW: 2,
        Reason.NO_OCCLUSION: 1,
        Reason.OCCLUDED: 1,
        Reason.NO_TRUNCATION: 1,
        Reason.TRUNCATED: 1,
    }
    assert counts.ignored["Car"]["hard"] == {
        Reason.NO_BOX: 1,
        Reason.LOW: 1,
        Reason.NO_OCCLUSION: 1,
        Reason.NO_TRUNCATION: 1,
    }
    assert counts.neighbours == {"Car": {"Van": 1}, "Pedestrian": {"Person_sitting": 0}}
    assert counts.dontcare == 1
    assert not counts.is_empty


@pytest.mark.parametrize(
    "how", [KITTI, protocol(difficulty="distance"), protocol(difficulty="none")]
)
def test_what_is_counted_is_what_the_evaluator_counts(how: Protocol) -> None:
    frames = [MIXED, frame(), frame(*(thing(z=z) for z in (-29.0, 31, 51, 71)))]
    counts = count_labels(frames, how)
    results = table_from_labels([nothing()] * 3)
    curves = evaluate(compare(table_from_labels(frames), results, how))
    for name, metrics in curves.items():
        for levels in metrics.values():
            assert {level: curve.n_gt for level, curve in levels.items()} == counts.counted[name]
    for name, n in counts.labels.items():
        for level in DIFFICULTIES:
            ignored = sum(counts.ignored[name][level].values())
            assert counts.counted[name][level] + ignored == n


def test_distance_goes_by_levels_that_hold_the_one_before_all_around() -> None:
    cars = frame(*(thing(height=0, occluded=3, z=z) for z in (-29.0, 30, 31, -50, 69, 71)))
    counts = count_labels([cars], protocol(difficulty="distance"))
    assert counts.counted["Car"] == {"easy": 2, "moderate": 4, "hard": 5}
    assert counts.ignored["Car"]["hard"] == {Reason.FAR: 1}
    near = count_labels([cars], protocol(difficulty="distance", limits=(10, 20, 30)))
    assert near.counted["Car"] == {"easy": 0, "moderate": 0, "hard": 2}


def test_points_go_by_their_number_and_need_it() -> None:
    cars = frame(*[thing(height=0)] * 5)
    how = protocol(difficulty="points")
    points = np.array([0, 1, 5, 6, 30])
    counted = count_labels([cars], how, points=points)
    assert counted.counted["Car"] == {"easy": 1, "moderate": 2, "hard": 4}
    assert counted.ignored["Car"]["easy"] == {Reason.FEW_POINTS: 4}
    with pytest.raises(ConfigError, match="points needs the clouds"):
        count_labels([cars], how)


def test_objects_outside_the_area_are_told_apart() -> None:
    counts = count_labels([frame(thing(), thing())], KITTI, ["Car"], np.array([True, False]))
    assert counts.counted == {"Car": {"easy": 1, "moderate": 1, "hard": 1}}
    assert counts.ignored["Car"]["easy"] == {Reason.OUTSIDE: 1}


def test_nothing_counts() -> None:
    assert count_labels([frame(thing(height=0), thing("Truck"))], KITTI).is_empty
    assert count_labels([], KITTI).is_empty


def test_results_are_counted_with_what_is_odd_about_them() -> None:
    rows = np.array([[*thing(height=h)[1], score] for h, score in ((50, 0.5), (30, 0.5), (0, 0.5))])
    rows[0, 13] = 90.0
    found = labels_from_columns(["Car", "Car", "Car"], rows, scored=True)
    counts = count_results(table_from_labels([found]), KITTI)
    assert counts.results == {"Car": 3, "Pedestrian": 0}
    assert counts.ignored["Car"]["easy"] == {Reason.NO_BOX: 1, Reason.LOW: 1}
    assert counts.ignored["Car"]["hard"] == {Reason.NO_BOX: 1}
    assert (counts.without_box, counts.turned, counts.equal) == (1, 1, {"Car": 0.5})


def test_degrees_are_seen_and_angles_that_are_unset_are_not() -> None:
    turned = frame(thing(), thing(), thing(), thing("DontCare"))
    turned.boxes_cam[:, 6] = [-180, -10, 6.28, -10]
    assert count_labels([turned], KITTI).turned == 1
