"""KITTI's rules by hand arithmetic; the numbers in the names are those of the official evaluator's logic."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fl3d.core.errors import ConfigError
from fl3d.data.label_table import table_from_labels
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.evaluation.average_precision import Curve, Curves, as_json, compare
from fl3d.evaluation.average_precision import evaluate as evaluate_comparison
from fl3d.evaluation.matching import hits_at_recalls, recall_thresholds
from fl3d.evaluation.protocol import Protocol

Row = tuple[str, list[float]]


def protocol(variant: str = "A", **overlaps: tuple[float, float, float]) -> Protocol:
    return Protocol("test", variant, overlaps or {"Car": (0.7, 0.5, 0.5)}, 0.0, 0.1, "standup", 100)


def thing(
    x: float,
    kind: str = "Car",
    height: float = 50,
    occluded: int = 0,
    truncated: float = 0,
    score: float | None = None,
) -> Row:
    """A car-sized box at x metres to the right, 20 m ahead; its 2D box stands alone as well."""
    box2d = [100 * x, 100.0, 100 * x + 80, 100 + height]
    row = [truncated, occluded, 0.0, *box2d, 1.5, 1.6, 4.0, 5 * x, 1.7, 20.0, 0.0]
    return kind, row if score is None else [*row, score]


def frame(*rows: Row) -> Labels:
    scored = bool(rows) and len(rows[0][1]) == 15
    width = 15 if scored else 14
    return labels_from_columns(
        [k for k, _ in rows], np.array([r for _, r in rows]).reshape(-1, width), scored
    )


def evaluate(
    gt: list[Labels], det: list[Labels], how: Protocol, beyond: np.ndarray | None = None
) -> Curves:
    return evaluate_comparison(compare(table_from_labels(gt), table_from_labels(det), how, beyond))


EMPTY = labels_from_columns([], np.zeros((0, 15)), scored=True)


def curve(
    gt: list[Labels], det: list[Labels], metric: str = "3d", level: str = "moderate", **kwargs: str
) -> Curve:
    return evaluate(gt, det, protocol(**kwargs))["Car"][metric][level]


def test_ground_truth_against_itself_is_100() -> None:
    gt = [frame(*(thing(x) for x in range(8))) for _ in range(6)]
    det = [frame(*(thing(x, score=1.0) for x in range(8))) for _ in range(6)]
    for metric in ("image", "bev", "3d"):
        for level in ("easy", "moderate", "hard"):
            found = curve(gt, det, metric, level)
            assert (found.ap_r11, found.ap_r40) == (100, 100)


def test_rule_1_difficulty_limits_are_inclusive() -> None:
    gt = [
        frame(
            thing(0, height=40),
            thing(1, occluded=1),
            thing(2, truncated=0.3),
            thing(3, truncated=0.31),
        )
    ]
    assert [curve(gt, [EMPTY], level=level).n_gt for level in ("easy", "moderate", "hard")] == [
        1,
        3,
        4,
    ]


def test_rule_1_variants_differ_at_the_minimum_height() -> None:
    gt = [frame(thing(0, height=25))]
    assert curve(gt, [EMPTY], variant="A").n_gt == 1
    assert curve(gt, [EMPTY], variant="B").n_gt == 0


def test_rule_1_a_detections_height_is_cut_to_whole_pixels() -> None:
    """24.9 px counts as 24, so the detection is ignored: the car is found by it, but neither hit nor miss."""
    gt = [frame(thing(0))]
    kind, row = thing(0, score=0.9)
    row[6] = row[4] + 24.9
    found = curve(gt, [frame((kind, row))])
    assert found.n_gt == 1
    assert len(found.thresholds) == 0


def test_rule_2_a_small_detection_of_any_class_can_take_a_car() -> None:
    """The small pedestrian takes the car first, so the better-placed car detection is a false alarm."""
    gt = [frame(thing(0), thing(1))]
    det = [
        frame(
            thing(0, "Pedestrian", height=10, score=0.95), thing(1, score=0.9), thing(0, score=0.8)
        )
    ]
    found = curve(gt, det)
    assert found.thresholds.tolist() == [0.9]


def test_rule_3_recall_divides_by_the_ground_truths_that_count() -> None:
    """One of two cars found without false alarm: recall 0.5, so precision is 1 up to sample 20 of 40."""
    gt = [frame(thing(0), thing(1))]
    found = curve(gt, [frame(thing(0, score=0.9))])
    assert found.n_gt == 2
    assert found.precision[0] == 1
    assert found.ap_r11 == pytest.approx(100 / 11)


def test_rule_4_ties_go_to_the_first_and_the_second_pass_prefers_overlap() -> None:
    gt = [frame(thing(0))]
    near, exact = thing(0.1, score=0.9), thing(0, score=0.8)
    found = curve(gt, [frame(near, exact)])
    # The threshold is the best score; at it only the nearer box is there.
    assert found.thresholds.tolist() == [0.9]
    assert (found.tp.tolist(), found.fp.tolist()) == ([1], [0])


def test_rule_4_a_valid_detection_replaces_an_ignored_one() -> None:
    gt = [frame(thing(0))]
    det = [frame(thing(0, height=10, score=0.95), thing(0, score=0.9))]
    found = curve(gt, det)
    assert len(found.thresholds) == 0  # first pass: the ignored one scores better and takes the car
    det = [frame(thing(0, height=10, score=0.8), thing(0, score=0.9))]
    assert curve(gt, det).tp.tolist() == [1]


def test_rule_5_thresholds_follow_recall_in_steps_of_a_fortieth() -> None:
    """With 80 hits of 80 every other one is nearest to a step of 1/40; the last is always kept."""
    scores = np.linspace(1, 0.01, 80)
    thresholds = recall_thresholds(scores, np.ones(80, dtype=np.int64), 80)
    assert len(thresholds) == 41
    assert thresholds[0] == scores[0]
    assert thresholds[-1] == scores[-1]


@pytest.mark.parametrize(
    ("n_gt", "hits"),
    [
        (1, range(41)),  # whoever has one hit stops at the first
        (40, range(41)),
        (80, [0, *range(1, 80, 2)]),
        (120, [0, *range(2, 120, 3)]),
    ],
)
def test_rule_5_by_hand(n_gt: int, hits: Sequence[int]) -> None:
    """Hit 0 stands for recall 0; a later one is passed over while the next brings recall nearer to the step."""
    assert hits_at_recalls(n_gt).tolist() == list(hits)


def test_rule_6_precision_is_made_monotone_from_the_right() -> None:
    """A false alarm above all hits: precision 1/2, 2/3, 3/4 becomes 3/4 throughout."""
    gt = [frame(thing(0), thing(1), thing(2))]
    det = [
        frame(thing(5, score=0.99), thing(0, score=0.9), thing(1, score=0.8), thing(2, score=0.7))
    ]
    found = curve(gt, det)
    assert found.precision[: len(found.thresholds)].tolist() == [0.75] * 3


def test_rule_6_one_hit_is_worth_one_step_of_r11_and_nothing_of_r40() -> None:
    gt = [frame(*(thing(x) for x in range(100)))]
    found = curve(gt, [frame(thing(0, score=0.9))])
    assert found.ap_r11 == pytest.approx(100 / 11)
    assert found.ap_r40 == 0


def test_rule_7_vans_are_neutral_and_names_compare_without_case() -> None:
    gt = [frame(thing(0, "car"), thing(1, "Van"), thing(2, "Truck"))]
    det = [frame(thing(0, "CAR", score=0.9), thing(1, score=0.99), thing(2, score=0.95))]
    found = curve(gt, det)
    assert found.n_gt == 1
    assert (found.tp.tolist(), found.fp.tolist()) == (
        [1],
        [1],
    )  # the van's is no false alarm, the truck's is


def test_rule_8_dontcare_excuses_false_alarms_in_the_image_alone() -> None:
    region = ("DontCare", [-1, -1, -10, 400, 90, 600, 160, -1, -1, -1, -1000, -1000, -1000, -10])
    gt = [frame(thing(0), region)]
    det = [frame(thing(0, score=0.9), thing(4, score=0.95))]
    assert curve(gt, det, "image").fp.tolist() == [0]
    assert curve(gt, det, "3d").fp.tolist() == [1]


def test_rule_9_a_frame_with_no_detections_counts_its_cars() -> None:
    gt = [frame(thing(0)), frame(thing(0))]
    assert curve(gt, [frame(thing(0, score=0.9)), EMPTY]).n_gt == 2


def test_overlap_must_exceed_the_minimum() -> None:
    """Shifted by a third of its length a box shares exactly half; shifted by a little less it is a hit."""
    gt = [frame(thing(0))]

    def shifted(metres: float) -> list[Labels]:
        kind, row = thing(0, score=0.9)
        row[10] = metres
        return [frame((kind, row))]

    assert curve(gt, shifted(4 / 3 + 1e-6), "bev").tp.tolist() == []
    assert curve(gt, shifted(4 / 3 - 1e-6), "bev").tp.tolist() == [1]


def test_cars_beyond_the_area_are_neutral() -> None:
    gt, det = [frame(thing(0), thing(1))], [frame(thing(0, score=0.9), thing(1, score=0.8))]
    found = evaluate(gt, det, protocol(), beyond=np.array([False, True]))["Car"]["3d"]["easy"]
    assert found.n_gt == 1
    assert (found.tp.tolist(), found.fp.tolist()) == ([1], [0])


def test_no_ground_truth_gives_zero_and_no_warning() -> None:
    found = curve([frame(thing(0, "Truck"))], [frame(thing(0, score=0.9))])
    assert (found.n_gt, found.ap_r11, found.ap_r40) == (0, 0, 0)


def test_degenerate_boxes_are_survived() -> None:
    kind, row = thing(0, score=0.9)
    row[8] = row[9] = 0.0
    kind2, row2 = thing(1, score=0.8)
    row2[8] = -1.0
    assert curve([frame(thing(0))], [frame((kind, row), (kind2, row2))]).n_gt == 1


def test_other_classes_have_their_own_overlaps() -> None:
    gt = [frame(thing(0, "Pedestrian"), thing(1, "Person_sitting"))]
    det = [frame(thing(0, "Pedestrian", score=0.9), thing(1, "Pedestrian", score=0.8))]
    curves = evaluate(gt, det, protocol(Pedestrian=(0.5, 0.25, 0.25)))
    assert list(curves) == ["Pedestrian"]
    found = curves["Pedestrian"]["bev"]["easy"]
    assert (found.n_gt, found.fp.tolist()) == (1, [0])


def test_unequal_numbers_of_frames_are_refused() -> None:
    with pytest.raises(ConfigError, match="2 frames of labels but 1 of detections"):
        evaluate([EMPTY, EMPTY], [EMPTY], protocol())


def angled(x: float, alpha: float, score: float | None = None) -> Row:
    kind, row = thing(x, score=score)
    row[2] = alpha
    return kind, row


def test_rule_10_orientation_similarity_and_the_angle_that_switches_it_off() -> None:
    """A quarter turn is worth one half; one detection without an angle ends it for all."""
    gt = [frame(angled(0, 0.0), angled(1, 0.0))]
    det = [frame(angled(0, np.pi / 2, 0.9), angled(1, 0.0, 0.8))]
    found = curve(gt, det, "image")
    assert found.orientation is not None
    assert found.orientation[:2] == pytest.approx(
        [0.75, 0.75]
    )  # (1/2 + 1) / 2, and 1/2 before made monotone
    assert "aos_r11" in as_json(evaluate(gt, det, protocol()))["Car"]["image"]["moderate"]
    switched = [frame(angled(0, np.pi / 2, 0.9), angled(1, -10.0, 0.8))]
    assert curve(gt, switched, "image").orientation is None
    assert curve(gt, det, "3d").orientation is None


def test_json_has_every_number_that_the_official_evaluator_counts() -> None:
    gt, det = [frame(thing(0), thing(1))], [frame(thing(0, score=0.9))]
    plain = as_json(evaluate(gt, det, protocol()))["Car"]["3d"]["easy"]
    assert set(plain) == {"n_gt", "thresholds", "tp", "fp", "precision", "ap_r11", "ap_r40"}
    assert len(plain["precision"]) == 41


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_the_order_of_frames_and_of_lines_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gt, det = [], []
    for _ in range(5):
        places = rng.permutation(20)[: rng.integers(1, 8)]
        gt.append([thing(float(x), occluded=int(rng.integers(0, 3))) for x in places])
        det.append(
            [thing(float(x) + rng.normal(0, 0.1), score=float(rng.random())) for x in places]
        )
    shuffled = rng.permutation(5)
    first = evaluate([frame(*g) for g in gt], [frame(*d) for d in det], protocol())["Car"]
    second = evaluate(
        [frame(*gt[i]) for i in shuffled],
        [frame(*(det[i][j] for j in rng.permutation(len(det[i])))) for i in shuffled],
        protocol(),
    )["Car"]
    for metric in first:
        for level in first[metric]:
            np.testing.assert_array_equal(
                first[metric][level].precision, second[metric][level].precision
            )
