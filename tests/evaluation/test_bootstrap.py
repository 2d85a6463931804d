"""How an AP moves when frames, or drives, are drawn again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fl3d.data.label_table import LabelTable
from fl3d.data.labels import Labels
from fl3d.evaluation import bootstrap
from fl3d.evaluation.average_precision import Comparison, compare, curve_of
from fl3d.evaluation.bootstrap import BLOCK, resampled_aps, unit_weights, widened
from fl3d.evaluation.matching import Int
from fl3d.evaluation.overlaps import find_overlaps
from fl3d.evaluation.recall import recall
from tests.evaluation.test_average_precision import EMPTY, frame, protocol, table_from_labels, thing


def scene(seed: int, n_frames: int = 40, noise: float = 0.1) -> tuple[list[Labels], list[Labels]]:
    """Frames of cars and noisy detections, some missed, some false, all with distinct scores."""
    rng = np.random.default_rng(seed)
    gt, det = [], []
    for _ in range(n_frames):
        places = rng.permutation(20)[: rng.integers(0, 8)]
        gt.append(frame(*(thing(float(x), occluded=int(rng.integers(0, 3))) for x in places)))
        found = [
            thing(float(x) + rng.normal(0, noise), score=float(rng.random()))
            for x in places
            if rng.random() < 0.8
        ]
        false = [
            thing(float(x) + 30, score=float(rng.random() * 0.7)) for x in range(rng.integers(0, 3))
        ]
        det.append(frame(*found, *false) if found or false else EMPTY)
    return gt, det


def comparison(gt: list[Labels], det: list[Labels]) -> Comparison:
    return compare(table_from_labels(gt), table_from_labels(det), protocol())


@pytest.mark.parametrize("seed", range(5))
def test_a_weighted_ap_is_the_ap_of_the_resampled_frames(seed: int) -> None:
    gt, det = scene(seed)
    whole = comparison(gt, det)
    weights = unit_weights(len(gt), 3, seed)
    for level in ("easy", "moderate", "hard"):
        fast = resampled_aps(whole.matches("Car", "3d", level), weights)
        for row, weight in zip(fast, weights, strict=True):
            chosen = np.repeat(np.arange(len(gt)), weight)
            assert row.tolist() == pytest.approx(aps_of(gt, det, chosen, level), rel=1e-12)


@pytest.mark.parametrize("digits", [1, 9])
def test_many_resamples_at_once_are_those_of_each_alone(digits: int) -> None:
    """More than are counted at once, and no multiple of it; with one digit most scores tie."""
    gt, det = scene(8)
    det = [replace(one, scores=np.round(one.scores, digits)) for one in det]
    whole = comparison(gt, det)
    matches = whole.matches("Car", "3d", "moderate")
    weights = unit_weights(len(gt), 2 * BLOCK + 5)
    found = resampled_aps(matches, weights)
    for number, weight in enumerate(weights):
        alone = resampled_aps(matches, weights[number : number + 1])
        assert found[number].tolist() == alone[0].tolist()
        chosen = np.repeat(np.arange(len(gt)), weight)
        assert found[number].tolist() == pytest.approx(
            aps_of(gt, det, chosen, "moderate"), rel=1e-12
        )
    assert len(np.unique(found)) > BLOCK


def test_counts_too_long_for_short_numbers_are_counted_in_long_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    matches = comparison(*scene(11)).matches("Car", "3d", "moderate")
    weights = unit_weights(40, 9)
    short = resampled_aps(matches, weights)
    monkeypatch.setattr(bootstrap, "SHORT", 0)
    assert resampled_aps(matches, weights).tolist() == short.tolist()


def test_without_detections_all_resamples_are_0() -> None:
    gt, det = scene(9)
    matches = comparison(gt, [EMPTY for _ in det]).matches("Car", "3d", "hard")
    assert not resampled_aps(matches, unit_weights(len(gt), BLOCK + 1)).any()


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_that_is_drawn_brings_all_its_frames_each_time(seed: int) -> None:
    """Drives of unequal size whose frames are not neighbours."""
    gt, det = scene(seed)
    drives = np.random.default_rng(seed).choice(5, len(gt), p=[0.5, 0.2, 0.15, 0.1, 0.05])
    weights = unit_weights(5, 4, seed)
    fast = resampled_aps(comparison(gt, det).matches("Car", "3d", "hard"), weights, drives)
    for row, weight in zip(fast, weights, strict=True):
        chosen = np.repeat(np.arange(len(gt)), weight[drives])
        assert len(chosen) == (weight * np.bincount(drives, minlength=5)).sum()
        assert row.tolist() == pytest.approx(aps_of(gt, det, chosen, "hard"), rel=1e-12)


def aps_of(gt: list[Labels], det: list[Labels], chosen: Int, level: str) -> list[float]:
    """R11 and R40 of some frames, which are matched anew."""
    curve = comparison([gt[i] for i in chosen], [det[i] for i in chosen]).curve("Car", "3d", level)
    return [curve.ap_r11, curve.ap_r40]


def test_frames_by_themselves_are_units_of_one() -> None:
    matches = comparison(*scene(6)).matches("Car", "3d", "moderate")
    weights = unit_weights(40, 20)
    assert (resampled_aps(matches, weights, np.arange(40)) == resampled_aps(matches, weights)).all()


def test_every_frame_once_gives_the_ap_itself() -> None:
    matches = comparison(*scene(7)).matches("Car", "bev", "moderate")
    curve = curve_of(matches)
    once = resampled_aps(matches, np.ones((1, 40), dtype=np.int32))[0]
    assert once.tolist() == pytest.approx([curve.ap_r11, curve.ap_r40], rel=1e-12)


def test_resamples_are_seeded_and_draw_as_many_units_as_there_are() -> None:
    weights = unit_weights(30, 50, seed=1)
    assert weights.shape == (50, 30)
    assert (weights.sum(axis=1) == 30).all()
    assert (unit_weights(30, 50, seed=2) != weights).any()
    unit_weights.cache_clear()
    assert (unit_weights(30, 50, seed=1) == weights).all()


def test_each_unit_is_drawn_as_often_as_chance_has_it() -> None:
    """Of 20 units each is left out of a resample with (1 - 1/20)^20, and drawn once on average."""
    weights = unit_weights(20, 5000)
    assert (weights == 0).mean() == pytest.approx((1 - 1 / 20) ** 20, abs=0.01)
    assert weights.mean(axis=0) == pytest.approx(np.ones(20), abs=0.06)
    assert weights.var(axis=0) == pytest.approx(np.full(20, 1 - 1 / 20), abs=0.1)


def test_draws_of_few_units_are_widened_by_t_and_by_the_unit_that_is_missing() -> None:
    """Ten drives alike: 2.262 / 1.960 times the root of 10 / 9; one that has nearly all frames leaves few."""
    draws = np.random.default_rng(0).normal(70.0, 2.0, (400, 2))
    found = widened(draws, np.repeat(np.arange(10), 7))
    assert found.mean(axis=0) == pytest.approx(draws.mean(axis=0))
    factor = 2.2622 / 1.9600 * (10 / 9) ** 0.5
    assert found.std(axis=0) / draws.std(axis=0) == pytest.approx([factor] * 2, rel=1e-4)
    unequal = widened(draws, np.repeat(np.arange(10), [91, *[1] * 9]))
    assert (unequal.std(axis=0) > 5 * draws.std(axis=0)).all()
    many = widened(draws, np.arange(1000))
    assert many == pytest.approx(draws, abs=0.02)


def test_widening_keeps_pairs_together() -> None:
    units = np.repeat(np.arange(6), 3)
    one, other = np.random.default_rng(1).normal(70.0, 2.0, (2, 300))
    assert widened(one, units) - widened(other, units) == pytest.approx(widened(one - other, units))


def test_a_resample_without_ground_truth_has_no_ap() -> None:
    gt = [EMPTY, frame(thing(0))]
    det = [frame(thing(0, score=0.5)), frame(thing(0, score=0.9))]
    matches = comparison(gt, det).matches("Car", "3d", "easy")
    weights = np.array([[2, 0], [0, 2]], dtype=np.int32)
    assert resampled_aps(matches, weights)[0].tolist() == [0.0, 0.0]
    assert resampled_aps(matches, weights)[1, 0] > 0


@pytest.mark.parametrize("seed", range(4))
def test_pairing_makes_a_difference_surer_than_other_frames_for_each_side(seed: int) -> None:
    """Two noisy readings of the same frames: what the frames share cancels if drawn together.

    Unpaired, each side has frames of its own and the variances add up. With the baseline on other
    frames the interval would be about as wide; paired it is at most two thirds of it. In R40, as
    R11 goes in jumps.
    """
    n_frames = 150
    n_resamples = 300
    gt, det = scene(seed, n_frames=n_frames)
    _, worse = scene(seed, n_frames=n_frames, noise=0.13)
    a = comparison(gt, det).matches("Car", "3d", "hard")
    b = comparison(gt, worse).matches("Car", "3d", "hard")
    first, second = (unit_weights(n_frames, n_resamples, own) for own in (1, 2))
    of_a = resampled_aps(a, first)[:, 1]
    paired, unpaired = (of_a - resampled_aps(b, weights)[:, 1] for weights in (first, second))
    assert width(paired) < 0.75 * width(unpaired)


def width(draws: NDArray[np.float64]) -> float:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(high - low)


def test_overlaps_of_some_detections_are_those_without_the_others() -> None:
    gt, det = (table_from_labels(side) for side in scene(10))
    chosen = np.random.default_rng(10).random(len(det.types)) < 0.6
    before = np.concatenate([[0], np.cumsum(chosen)])
    left = LabelTable(before[det.offsets], det.types[chosen], det.values[chosen])
    found, alone = find_overlaps(gt, det).of(chosen), find_overlaps(gt, left)
    assert 0 < len(alone.detection) < len(find_overlaps(gt, det).detection)
    for name, values in vars(alone).items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_recall_by_hand() -> None:
    """Two of three cars have a box: one exactly, one shifted by a quarter of its length (3D overlap 0.6)."""
    gt = table_from_labels(
        [frame(thing(0), thing(1, occluded=3), thing(2)), frame(thing(0, "Van"))]
    )
    kind, shifted = thing(1, score=0.01)
    shifted[10] += 1.0
    det = table_from_labels([frame(thing(0, score=0.5), (kind, shifted)), EMPTY])
    found = recall(gt, find_overlaps(gt, det), "Car")
    assert found == pytest.approx([2 / 3, 2 / 3, 2 / 3, 1 / 3, 1 / 3])


def test_recall_without_ground_truths_is_zero() -> None:
    nothing = LabelTable(
        np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 15))
    )
    assert recall(nothing, find_overlaps(nothing, nothing), "Car").tolist() == [0] * 5
