"""Overlaps: by hand, and against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from fl3d.core.errors import ConfigError
from fl3d.geometry.boxes import standup
from fl3d.geometry.iou import bev_and_3d_iou_cam, bev_and_3d_iou_velo, bev_iou, image_iou
from fl3d.geometry.nms import nms

rectangle = st.tuples(
    st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 6), st.floats(0.1, 6), st.floats(-7, 7)
).map(np.array)


def polygon(r: np.ndarray) -> shapely.Polygon:
    box = shapely.box(-r[2] / 2, -r[3] / 2, r[2] / 2, r[3] / 2)
    turned = shapely.affinity.rotate(box, r[4], origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, r[0], r[1])


@given(rectangle, rectangle)
def test_bev_iou_equals_shapely(a: np.ndarray, b: np.ndarray) -> None:
    p, q = polygon(a), polygon(b)
    shared = p.intersection(q).area
    expected = shared / (p.area + q.area - shared)
    assert bev_iou(a[None], b[None])[0, 0] == pytest.approx(expected, abs=1e-9)


def test_half_shifted_squares_share_a_third() -> None:
    a, b = np.array([[0.0, 0, 2, 2, 0]]), np.array([[1.0, 0, 2, 2, 0]])
    assert bev_iou(a, b)[0, 0] == pytest.approx(1 / 3)


def test_a_box_equals_itself_and_its_half_turn() -> None:
    a = np.array([[70.0, -39.0, 3.9, 1.6, 0.3], [70.0, -39.0, 3.9, 1.6, 0.3 + np.pi]])
    np.testing.assert_allclose(bev_iou(a, a), 1, atol=1e-12)


def test_degenerate_boxes_overlap_nothing() -> None:
    a = np.array([[0.0, 0, 0, 0, 0], [0.0, 0, -1, 2, 0], [0.0, 0, 2, 2, 0]])
    assert bev_iou(a, a).tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 1]]


def test_3d_iou_counts_height_above_the_bottom() -> None:
    """Same footprint, half the height shared: 1/3 in 3D, 1 from above."""
    a = np.array([[0.0, 0.0, 10.0, 2.0, 2.0, 4.0, 0.0]])
    b = a + np.array([0, -1.0, 0, 0, 0, 0, 0])  # one metre up: y points down
    bev, volume = bev_and_3d_iou_cam(a, b)
    assert bev[0, 0] == pytest.approx(1)
    assert volume[0, 0] == pytest.approx(1 / 3)


def test_image_overlap_over_the_detection() -> None:
    """DontCare's rule divides by the detection's own area."""
    det, region = np.array([[0.0, 0, 2, 2]]), np.array([[1.0, 0, 11, 2]])
    assert image_iou(det, region, over_a=True)[0, 0] == 0.5
    assert image_iou(det, region)[0, 0] == pytest.approx(2 / 22)


def test_nms_keeps_the_best_of_each_heap() -> None:
    rectangles = np.array(
        [[0.0, 0, 4, 2, 0], [0.5, 0, 4, 2, 0], [20.0, 0, 4, 2, 0], [0.2, 0, 4, 2, 0]]
    )
    kept = nms(rectangles, np.array([0.5, 0.9, 0.1, 0.7]), iou=0.1, kind="standup", max_kept=9)
    assert kept.tolist() == [1, 2]


def test_standup_nms_suppresses_where_rotated_does_not() -> None:
    """Two slanted cars side by side: their hulls overlap, they do not."""
    turn = np.pi / 4
    rectangles = np.array([[0.0, 0, 4, 1.6, turn], [-1.3, 1.3, 4, 1.6, turn]])
    scores = np.array([0.9, 0.8])
    assert nms(rectangles, scores, 0.1, "standup", 9).tolist() == [0]
    assert nms(rectangles, scores, 0.1, "rotated", 9).tolist() == [0, 1]


def test_nms_stops_at_the_maximum() -> None:
    rectangles = np.array([[10.0 * i, 0, 4, 2, 0] for i in range(5)])
    assert nms(rectangles, np.arange(5.0), 0.1, "rotated", 2).tolist() == [4, 3]


def test_unknown_kind_of_nms_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="rotated, standup"):
        nms(np.zeros((0, 5)), np.zeros(0), 0.1, "stand", 9)


def test_nms_in_3d_keeps_what_stands_on_top() -> None:
    """Two boxes of a height 2 on one footprint, 1 m apart in height: a third of their union is shared."""
    rectangles, spans = np.array([[0.0, 0, 4, 2, 0.3]] * 2), np.array([[0.0, 2.0], [1.0, 3.0]])
    scores = np.array([0.9, 0.8])
    assert nms(rectangles, scores, 0.1, "rotated", 9).tolist() == [0]
    assert nms(rectangles, scores, 0.33, "3d", 9, spans).tolist() == [0]
    assert nms(rectangles, scores, 0.34, "3d", 9, spans).tolist() == [0, 1]
    assert nms(rectangles, scores, 0.0, "3d", 9, spans + [[0, 0], [1, 1]]).tolist() == [0, 1]


@pytest.mark.parametrize("kind", ["standup", "rotated", "3d"])
@given(
    seed=st.integers(0, 2**31),
    spread=st.sampled_from([5.0, 60.0]),
    iou=st.sampled_from([0.0, 0.1, 0.5]),
)
def test_nms_equals_its_plain_definition(kind: str, seed: int, spread: float, iou: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    shape = (
        rng.uniform(-spread, spread, (n, 2)),
        rng.uniform(0.3, 6, (n, 2)),
        rng.uniform(-4, 4, (n, 1)),
    )
    rectangles, scores = np.concatenate(shape, axis=1), rng.random(n)
    hulls = standup(rectangles)
    lowest, height = rng.uniform(-2, 0, n), rng.uniform(0.5, 2, n)
    boxes = np.column_stack([rectangles[:, :2], lowest, height, rectangles[:, [3, 2, 4]]])
    overlap = {
        "standup": lambda: image_iou(hulls, hulls),
        "rotated": lambda: bev_iou(rectangles, rectangles),
        "3d": lambda: bev_and_3d_iou_velo(boxes, boxes)[1],
    }[kind]()
    kept: list[int] = []
    for i in np.argsort(-scores):
        if all(overlap[j, i] <= iou for j in kept):
            kept.append(int(i))
    assert (
        nms(rectangles, scores, iou, kind, n, np.column_stack([lowest, lowest + height])).tolist()
        == kept
    )
