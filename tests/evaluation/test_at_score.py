"""What is found at one score agrees with the curve that counts it."""

import numpy as np
import pytest

from fl3d.evaluation.at_score import at_score, score_of_alarms
from fl3d.evaluation.average_precision import curve_of
from fl3d.evaluation.matching import Matches
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from tests.evaluation.test_bootstrap import comparison, scene


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_hits_and_alarms_are_those_of_the_curve(metric: str, difficulty: str) -> None:
    one = comparison(*scene(3))
    curve = curve_of(one.matches("Car", metric, difficulty))
    assert len(curve.thresholds) > 5
    for score, tp, fp in zip(curve.thresholds, curve.tp, curve.fp, strict=True):
        at = at_score(one, "Car", metric, difficulty, score)
        assert ((at.found == 1).sum(), at.hit.sum(), at.alarm.sum()) == (tp, tp, fp)
        assert at.counts.sum() == curve.n_gt
        assert not (at.found[~at.counts] >= 0).any()


def events(scores: list[float], fp: list[int]) -> Matches:
    n = len(scores)
    none, zero = np.zeros(0), np.zeros(n, dtype=np.int64)
    frames = np.zeros(0, dtype=np.int64)
    return Matches(
        zero, none, frames, np.array(scores), zero, zero, np.array(fp, dtype=np.int64), none
    )


def test_the_lowest_score_with_few_enough_alarms() -> None:
    """One alarm at 0.9, two more at 0.7, a fourth at 0.5; at 0.6 a box that was one hits."""
    matches = events([0.9, 0.8, 0.7, 0.7, 0.6, 0.5], [1, 0, 1, 1, -1, 1])
    assert score_of_alarms(matches, 0) == np.inf
    assert score_of_alarms(matches, 1) == 0.8
    assert score_of_alarms(matches, 2) == 0.8  # both at 0.7 come at once
    assert score_of_alarms(matches, 3) == -np.inf
    assert score_of_alarms(events([], []), 0) == -np.inf
