"""How sure an AP is."""

import numpy as np
import pytest

from fl3d.core.errors import ConfigError
from fl3d.data.label_table import LabelTable
from fl3d.data.labels import Labels
from fl3d.evaluation.average_precision import Comparison, compare, curve_of
from fl3d.evaluation.bootstrap import R11_STEP, frame_weights, paired_bootstrap, resampled_aps
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
    weights = frame_weights(len(gt), 3, seed)
    for level in ("easy", "moderate", "hard"):
        fast = resampled_aps(whole.matches("Car", "3d", level), weights)
        for row, weight in zip(fast, weights, strict=True):
            chosen = np.repeat(np.arange(len(gt)), weight)
            curve = comparison([gt[i] for i in chosen], [det[i] for i in chosen]).curve(
                "Car", "3d", level
            )
            assert row.tolist() == pytest.approx([curve.ap_r11, curve.ap_r40], rel=1e-12)


def test_every_frame_once_gives_the_ap_itself() -> None:
    matches = comparison(*scene(7)).matches("Car", "bev", "moderate")
    curve = curve_of(matches)
    once = resampled_aps(matches, np.ones((1, 40), dtype=np.int64))[0]
    assert once.tolist() == pytest.approx([curve.ap_r11, curve.ap_r40], rel=1e-12)


def test_resamples_are_seeded_and_draw_as_many_frames_as_there_are() -> None:
    weights = frame_weights(30, 50, seed=1)
    assert (weights.sum(axis=1) == 30).all()
    assert (frame_weights(30, 50, seed=1) == weights).all()
    assert (frame_weights(30, 50, seed=2) != weights).any()


def test_a_detector_against_itself_gains_nothing() -> None:
    matches = comparison(*scene(1)).matches("Car", "3d", "moderate")
    found = paired_bootstrap([matches], [matches], n_resamples=100)
    assert (found.gain[0].value, found.gain[0].low, found.gain[0].high) == (0, 0, 0)
    assert not found.gain[0].excludes_zero
    assert found.ap[1].low <= found.ap[1].value <= found.ap[1].high


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
    paired = paired_bootstrap([a], [b], n_resamples=n_resamples).gain[1]
    of_a = resampled_aps(a, frame_weights(n_frames, n_resamples, seed=1))[:, 1]
    of_b = resampled_aps(b, frame_weights(n_frames, n_resamples, seed=2))[:, 1]
    low, high = np.percentile(of_a - of_b, [2.5, 97.5])
    assert paired.high - paired.low < 0.75 * (high - low)


def test_a_clear_loss_is_seen() -> None:
    gt, det = scene(3, n_frames=150)
    bad = [d.select(np.arange(len(d)) % 2 == 0) for d in det]
    a, b = (comparison(gt, d).matches("Car", "3d", "hard") for d in (bad, det))
    gain = paired_bootstrap([a], [b], n_resamples=300).gain
    assert gain[1].value < 0
    assert gain[1].excludes_zero


def test_seeds_widen_the_interval() -> None:
    """Two training seeds far apart: resampling them as well says so."""
    gt, det = scene(4, n_frames=150)
    bad = [d.select(np.arange(len(d)) % 2 == 0) for d in det]
    good, poor = (comparison(gt, d).matches("Car", "3d", "hard") for d in (det, bad))
    one = paired_bootstrap([good], [good], n_resamples=300).ap[1]
    two = paired_bootstrap([good, poor], [good, good], n_resamples=300).ap[1]
    assert two.high - two.low > 1.5 * (one.high - one.low)
    assert two.value == pytest.approx((resampled(good) + resampled(poor)) / 2)


def resampled(matches: object) -> float:
    return float(resampled_aps(matches, np.ones((1, 150), dtype=np.int64))[0, 1])  # type: ignore[arg-type]


def test_a_gain_of_one_recall_step_is_flagged() -> None:
    """Of 100 cars one more is found, without a false alarm: R11 jumps at one of its samples and stands elsewhere."""
    gt = [frame(thing(0)) for _ in range(100)]

    def finding(n: int) -> Comparison:
        return comparison(
            gt, [frame(thing(0, score=0.9 - i / 1000)) if i < n else EMPTY for i in range(100)]
        )

    flagged = []
    for n in range(12, 24):
        a, b = (finding(k).matches("Car", "3d", "moderate") for k in (n + 1, n))
        found = paired_bootstrap([a], [b], n_resamples=20)
        assert found.one_step == (found.gain[0].value == pytest.approx(R11_STEP))
        flagged.append(found.one_step)
    assert flagged.count(True) == 1


def test_different_frames_or_seeds_are_refused() -> None:
    a = comparison(*scene(0, 10)).matches("Car", "3d", "easy")
    b = comparison(*scene(0, 11)).matches("Car", "3d", "easy")
    with pytest.raises(ConfigError, match="same frames"):
        paired_bootstrap([a], [b])
    with pytest.raises(ConfigError, match="same seeds"):
        paired_bootstrap([a, a], [a])


def test_recall_by_hand() -> None:
    """Two of three cars have a box: one exactly, one shifted by a quarter of its length (3D overlap 0.6)."""
    gt = table_from_labels(
        [frame(thing(0), thing(1, occluded=3), thing(2)), frame(thing(0, "Van"))]
    )
    kind, shifted = thing(1, score=0.01)
    shifted[10] += 1.0
    det = table_from_labels([frame(thing(0, score=0.5), (kind, shifted)), EMPTY])
    found = recall(gt, find_overlaps(gt, det))
    assert found == pytest.approx([2 / 3, 2 / 3, 2 / 3, 1 / 3, 1 / 3])


def test_recall_without_ground_truths_is_zero() -> None:
    nothing = LabelTable(
        np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 15))
    )
    assert recall(nothing, find_overlaps(nothing, nothing)).tolist() == [0] * 5
