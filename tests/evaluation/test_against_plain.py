"""The fast evaluator against the plain one, on scenes made to be awkward."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fl3d.data.label_table import table_from_labels
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.evaluation.average_precision import compare, evaluate
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol
from tests.evaluation.plain import evaluate_plainly

KINDS = [
    *["Car"] * 4,
    "car",
    "Van",
    "Pedestrian",
    "Person_sitting",
    "Cyclist",
    "Truck",
    "DontCare",
    "Boat",
]
OVERLAPS = {"Car": (0.7, 0.5, 0.5), "Pedestrian": (0.5, 0.25, 0.25), "Cyclist": (0.5, 0.5, 0.25)}


def awkward_scene(rng: np.random.Generator, n_frames: int) -> tuple[list[Labels], list[Labels]]:
    """Crowds that overlap each other, equal scores, heights at the limits, empty frames, boxes without extent."""
    return tuple(zip(*(awkward_frame(rng) for _ in range(n_frames)), strict=True))  # type: ignore[return-value]


def awkward_frame(rng: np.random.Generator) -> tuple[Labels, Labels]:
    gt = [row(rng, str(rng.choice(KINDS))) for _ in range(rng.integers(0, 9))]
    det = []
    for _ in range(rng.integers(0, 14)):
        if gt and rng.random() < 0.7:
            kind, values = gt[rng.integers(len(gt))]
            values = values + np.concatenate(
                [[0, 0, 0], rng.normal(0, 4, 4), rng.normal(0, 0.15, 6), [0.0]]
            )
            kind = kind if rng.random() < 0.8 else str(rng.choice(KINDS))
        else:
            kind, values = row(rng, str(rng.choice(KINDS)))
        values[0] = values[1] = 0
        det.append((kind, np.append(values, rng.choice([0.1, 0.2, 0.5, 0.5, 0.9, rng.random()]))))
    return pack(gt, 14), pack(det, 15)


def row(rng: np.random.Generator, kind: str) -> tuple[str, np.ndarray]:
    x, z = rng.uniform(-4, 4), rng.uniform(10, 18)
    left, top = 60 * x + rng.normal(0, 5), rng.uniform(100, 120)
    height = rng.choice([24.9, 25.0, 25.5, 39.9, 40.0, 60.0])
    size = rng.choice([0.0, -1.0]) if rng.random() < 0.04 else rng.uniform(1.4, 1.8)
    box3d = [1.5, size, rng.uniform(3.4, 4.4), x, 1.7, z, rng.uniform(-3, 3)]
    if kind == "DontCare":
        box3d = [-1, -1, -1, -1000, -1000, -1000, -10]
    occluded, truncated = int(rng.integers(0, 4)), rng.choice([0, 0.15, 0.16, 0.3, 0.5, 0.6])
    return kind, np.array([truncated, occluded, 0.5, left, top, left + 90, top + height, *box3d])


def pack(rows: list[tuple[str, np.ndarray]], width: int) -> Labels:
    values = np.array([v for _, v in rows]).reshape(-1, width)
    return labels_from_columns([k for k, _ in rows], values, scored=width == 15)


@pytest.mark.parametrize("variant", ["A", "B"])
@settings(max_examples=30)
@given(seed=st.integers(0, 2**31))
def test_both_count_the_same(variant: str, seed: int) -> None:
    gt, det = awkward_scene(np.random.default_rng(seed), 6)
    protocol = Protocol("test", variant, OVERLAPS, 0.0, 0.1, "standup", 100)
    curves = evaluate(compare(table_from_labels(gt), table_from_labels(det), protocol))
    for name, minimum in OVERLAPS.items():
        for m, metric in enumerate(METRICS):
            for level in DIFFICULTIES:
                curve = curves[name][metric][level]
                expected = evaluate_plainly(
                    list(gt), list(det), name.lower(), metric, level, variant, minimum[m]
                )
                found = (
                    curve.n_gt,
                    curve.thresholds.tolist(),
                    curve.tp.tolist(),
                    curve.fp.tolist(),
                )
                assert found == expected, (name, metric, level)


def test_the_scenes_are_awkward_enough() -> None:
    """Hits, misses, false alarms and ties all happen, often."""
    gt, det = awkward_scene(np.random.default_rng(0), 150)
    protocol = Protocol("test", "A", OVERLAPS, 0.0, 0.1, "standup", 100)
    curves = evaluate(compare(table_from_labels(gt), table_from_labels(det), protocol))["Car"]
    for metric in METRICS:
        curve = curves[metric]["hard"]
        assert 15 < curve.tp[-1] < curve.n_gt
        assert curve.fp[-1] > 20
    scores = np.concatenate([d.scores for d in det if d.scores is not None])
    assert len(np.unique(scores)) < len(scores)
