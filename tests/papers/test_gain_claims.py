"""Sentences of the paper about gains: what its own cells say of them, and ours by intervals that hold at once."""

from collections.abc import Sequence

import numpy as np
import pytest

from fl3d.evaluation.intervals import Interval, Sample
from fl3d.papers.claim import Claim, claims_table
from fl3d.papers.focal_loss.gain_claims import (
    SENTENCES,
    Extreme,
    GainsByAverage,
    gain_claims,
    published_last,
)
from fl3d.reports.table import AP_COLUMNS
from tests.papers.null_sweeps import NoEffect

LARGEST = "largest gain of 3D-FCN for 0 < γ ≤ 2"
SMALLEST = "smallest gain of 3D-FCN for 0 < γ ≤ 2"
SHAKE = np.array([-0.01, 0.0, 0.01])  # between seeds and in resamples: far below any gain here


def sure(gain: float, n_seeds: int = 3) -> Sample:
    """A gain that training and frames hardly move."""
    return Sample(gain + np.resize(SHAKE, n_seeds), gain + SHAKE)


def gains_of(detector: str, n_seeds: int = 3, **changed: float) -> dict[str, GainsByAverage]:
    """The paper's own gains as if they were ours, but for some cells: ``g01_3d_easy=3``."""
    aps = published_last(detector)
    gains = {
        (float(gamma), column): sure(float(aps.loc[gamma, column] - aps.loc[0.0, column]), n_seeds)
        for gamma in aps.index[1:]
        for column in AP_COLUMNS
    }
    for name, gain in changed.items():
        gamma, _, column = name[1:].partition("_")
        gains[float(gamma) / 10, column] = sure(gain, n_seeds)
    return {detector: {"R11": gains, "R40": gains}}


def claims_of(ours: dict[str, GainsByAverage]) -> dict[str, Claim]:
    """By their texts; of the same text the first."""
    found: dict[str, Claim] = {}
    for claim in gain_claims(ours):
        found.setdefault(claim.text, claim)
    return found


def test_the_papers_own_cells_give_its_claims() -> None:
    found = {(claim.text, claim.printed): claim for claim in gain_claims({})}
    assert found[LARGEST, "11.2"].recomputed == "11.21"
    assert found[LARGEST, "11.2"].verdict == "printed correctly"
    assert found[SMALLEST, "0.3"].recomputed == "0.38"
    assert found[SMALLEST, "0.5"].verdict == "printed wrong"
    assert found["largest loss of VoxelNet for γ = 0.2, 2", "2.7"].recomputed == "2.71"
    assert found["largest loss of VoxelNet for γ = 5", ""].recomputed == "7.21"


def test_gains_that_are_sure_are_told_by_their_intervals() -> None:
    found = claims_of(gains_of("3D-FCN"))
    largest = found[LARGEST]
    assert largest.ours.startswith("R11 +11.21 [")
    assert largest.ours.endswith("; 3 seeds")
    within = "11.2 lies within ours (R11)"
    assert largest.verdict == (
        f"printed correctly; ours: larger in at least one of 30 cells (R40); {within}"
    )
    assert "ours: larger in all 30 cells (R40)" in found[SMALLEST].verdict
    loss = claims_of(gains_of("VoxelNet"))["largest loss of VoxelNet for γ = 0.2, 2"]
    assert loss.ours.startswith("R11 +2.71 [")
    assert "ours: smaller in at least one of 12 cells (R40); 2.7 lies within" in loss.verdict


def test_one_loss_is_against_a_smallest_gain_and_not_against_a_largest() -> None:
    found = claims_of(gains_of("3D-FCN", g20_3d_hard=-1.0))
    assert "ours: smaller in at least one of 30 cells" in found[SMALLEST].verdict
    assert "0.3 lies outside ours" in found[SMALLEST].verdict
    assert "ours: larger in at least one of 30 cells" in found[LARGEST].verdict


def test_a_gain_outside_the_sentences_gammas_does_not_count() -> None:
    assert claims_of(gains_of("3D-FCN", g50_3d_hard=-40.0)) == claims_of(gains_of("3D-FCN"))


@pytest.mark.parametrize(
    ("n_seeds", "said"),
    [(1, "ours: frames only, not training"), (2, "ours: no verdict before 3 seeds")],
)
def test_one_or_two_seeds_give_no_verdict_however_large_the_gain(n_seeds: int, said: str) -> None:
    found = claims_of(gains_of("3D-FCN", n_seeds, g10_3d_easy=40.0))
    assert found[LARGEST].verdict == f"printed correctly; {said}"
    assert f"; {n_seeds} seed" in found[LARGEST].ours


def test_the_level_with_the_fewest_seeds_decides_whether_there_is_a_verdict() -> None:
    ours = gains_of("3D-FCN")
    gains = dict(ours["3D-FCN"]["R40"])
    gains.update({place: sure(1.0, 2) for place in gains if place[0] == 0.5})
    (largest, *_) = gain_claims({"3D-FCN": {"R11": gains, "R40": gains}})
    assert largest.verdict.endswith("ours: no verdict before 3 seeds")
    assert largest.ours.endswith("; 2 to 3 seeds")


def test_words_come_from_r40_and_the_printed_number_is_held_against_r11() -> None:
    r11 = gains_of("3D-FCN")["3D-FCN"]["R11"]
    r40 = {place: Sample(np.array([-2.0, 0.0, 2.0]), np.array([-1.0, 1.0])) for place in r11}
    largest = claims_of({"3D-FCN": {"R11": r11, "R40": r40}})[LARGEST]
    assert largest.verdict == (
        "printed correctly; ours: not distinguishable from 0 (R40); 11.2 lies within ours (R11)"
    )


def test_a_store_without_a_detector_has_no_number_for_it() -> None:
    assert {claim.ours for claim in gain_claims({})} == {""}
    nothing: dict[str, GainsByAverage] = {"VoxelNet": {"R11": {}, "R40": {}}}  # no gamma = 0
    assert {claim.ours for claim in gain_claims(nothing)} == {""}


def test_a_claim_of_some_of_its_gammas_says_of_which() -> None:
    gains = {(0.5, column): sure(2.0) for column in AP_COLUMNS}
    claims = gain_claims({"VoxelNet": {"R11": gains, "R40": gains}})
    told = [claim for claim in claims if claim.ours]
    assert all(claim.ours.startswith("R11 +2.00 [") for claim in told)
    assert [claim.text.partition(" (")[2] for claim in told] == ["ours: γ = 0.5)"] * 2


def test_the_extreme_lies_between_the_extremes_of_the_ends() -> None:
    found = [Interval(3.0, -9.0, 10.0), Interval(1.0, 0.5, 1.5), Interval(-2.0, -3.0, 4.0)]
    assert Extreme.LARGEST_GAIN.of_gains(found) == Interval(3.0, 0.5, 10.0)
    assert Extreme.SMALLEST_GAIN.of_gains(found) == Interval(-2.0, -9.0, 1.5)
    loss = Extreme.LARGEST_LOSS
    assert loss.as_told(loss.of_gains(found)) == Interval(2.0, -1.5, 9.0)


def said_of(claims: Sequence[Claim]) -> list[bool]:
    """Of which claims something is said for or against an effect."""
    return [any(word in claim.verdict for word in ("larger", "smaller")) for claim in claims]


def has_sign_alone(sweep: dict[str, GainsByAverage]) -> bool:
    """Whether the sign of the largest gain, judged by nothing else, says that there is one."""
    to_two = SENTENCES[0].gammas
    gains = sweep["3D-FCN"]["R11"]
    return max(float(gains[place].values.mean()) for place in gains if place[0] in to_two) > 0


def test_under_no_effect_the_sign_of_the_largest_gain_says_one_and_its_interval_does_not() -> None:
    case = NoEffect(n_seeds=3, of_training=1.5, of_frames=1.0, n_resamples=100)
    rng = np.random.default_rng(0)
    sweeps = [case.gains(rng) for _ in range(20)]
    assert np.mean([has_sign_alone(sweep) for sweep in sweeps]) > 0.9
    assert np.mean([said_of(gain_claims(sweep)) for sweep in sweeps]) <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        NoEffect(n_seeds=3, of_training=1.5, of_frames=1.0),
        NoEffect(n_seeds=5, of_training=1.5, of_frames=1.0),
        NoEffect(n_seeds=5, of_training=0.0, of_frames=1.5, alike=1.0, n_resamples=1500),
    ],
    ids=["three seeds", "five seeds", "frames alone"],
)
def test_no_claim_is_judged_more_than_once_in_twenty_sweeps_without_effect(case: NoEffect) -> None:
    rng = np.random.default_rng(1)
    said = [said_of(gain_claims(case.gains(rng))) for _ in range(400)]
    assert np.mean(said, axis=0).max() <= 0.05


def test_what_nothing_is_known_of_is_a_dash() -> None:
    table = claims_table(gain_claims({}))
    assert {cell.text for cell in table.column("ours")} == {"–"}
