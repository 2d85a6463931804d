"""Sentences of the paper about posteriors: judged seed by seed, and by their peak."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from fl3d.papers.focal_loss.posterior_claims import (
    HARDEST,
    Peak,
    half_claim,
    hardest_share,
    peak_claim,
    peak_of,
)
from fl3d.papers.focal_loss.window_figures import HITS

Peaks = Mapping[float, Mapping[int, Peak]]


def peaks(base: Sequence[Peak], focal: Sequence[Peak]) -> Peaks:
    """Of gamma 0 and 5, by seed; one between them, that does not matter."""
    return {0.0: dict(enumerate(base)), 2.0: {0: Peak(99.0, 0.01)}, 5.0: dict(enumerate(focal))}


def test_a_peak_is_the_fullest_bin() -> None:
    p = np.array([0.90, 0.91, 0.905, 0.1, 0.3])  # three of five in the bin from 0.88 to 0.92
    assert peak_of(p) == Peak(pytest.approx(3 / 5 * 25), pytest.approx(0.9))


def test_the_peak_is_judged_and_not_the_median() -> None:
    """Two thirds of the posteriors stay where they are; the fullest bin loses height and place."""
    rng = np.random.default_rng(0)
    low = rng.uniform(0, 0.2, 6000)
    base = [peak_of(np.concatenate([low, rng.normal(0.9, 0.01, 3000)])) for _ in range(3)]
    focal = [peak_of(np.concatenate([low, rng.normal(0.5, 0.03, 3000)])) for _ in range(3)]
    claim = peak_claim("3D-FCN", HITS, peaks(base, focal))
    assert claim.verdict == "ours: height smaller, place smaller"
    assert "(γ = 0)" in claim.ours
    assert "(γ = 5)" in claim.ours
    assert claim.ours.endswith("] over seeds; 3 seeds")
    assert "3D-FCN's evaluated boxes on cars" in claim.text


def test_a_place_is_no_more_exact_than_its_bins() -> None:
    """All seeds one bin lower: no spread between seeds, and yet no more than a bin."""
    base = [Peak(9.0, 0.9), Peak(9.2, 0.9), Peak(8.8, 0.9)]
    one = [Peak(5.0, 0.86), Peak(5.1, 0.86), Peak(4.9, 0.86)]
    two = [Peak(5.0, 0.82), Peak(5.1, 0.82), Peak(4.9, 0.82)]
    not_told = "ours: height smaller, place not distinguishable from 0"
    assert peak_claim("3D-FCN", HITS, peaks(base, one)).verdict == not_told
    assert (
        peak_claim("3D-FCN", HITS, peaks(base, two)).verdict
        == "ours: height smaller, place smaller"
    )


def test_a_rise_is_told_as_a_rise() -> None:
    base = [Peak(5.0, 0.1), Peak(5.1, 0.1), Peak(4.9, 0.1)]
    focal = [Peak(9.0, 0.9), Peak(9.2, 0.9), Peak(8.8, 0.9)]
    claim = peak_claim("VoxelNet", HITS, peaks(base, focal))
    assert claim.verdict == "ours: height larger, place larger"


@pytest.mark.parametrize(
    ("n_seeds", "said"), [(1, "frames only, not training"), (2, "no verdict before 3 seeds")]
)
def test_one_or_two_seeds_give_no_verdict(n_seeds: int, said: str) -> None:
    claim = peak_claim(
        "3D-FCN", HITS, peaks([Peak(9.0, 0.9)] * n_seeds, [Peak(1.0, 0.1)] * n_seeds)
    )
    assert claim.verdict == f"ours: {said}"
    half = half_claim(2.0, [(0.5, 0.6)] * n_seeds)
    assert half.verdict == f"ours: {said}"


def test_seeds_without_a_pair_are_left_out() -> None:
    given = {0.0: {seed: Peak(9.0, 0.9) for seed in range(3)}, 5.0: {0: Peak(1.0, 0.1)}}
    assert peak_claim("3D-FCN", HITS, given).ours.endswith("; 1 seed")


@pytest.mark.parametrize("given", [{}, {0.0: {0: Peak(1.0, 0.5)}}, {5.0: {0: Peak(1.0, 0.5)}}])
def test_without_both_ends_nothing_is_said(given: Peaks) -> None:
    claim = peak_claim("3D-FCN", HITS, given)
    assert (claim.ours, claim.verdict) == ("", "")


@pytest.mark.parametrize("n_seeds", [3, 5])
def test_posteriors_of_one_kind_seldom_differ(n_seeds: int) -> None:
    """Each model has a mode and a width of its own, gamma or not; 300 pairs tell 5 % to two standard errors of 1.3."""
    rng = np.random.default_rng(0)

    def peak() -> Peak:
        mode, width = rng.normal(0.7, 0.05), rng.uniform(0.05, 0.1)
        return peak_of(rng.normal(mode, width, 500).clip(0, 1))

    said = 0
    for _ in range(300):
        base, focal = ([peak() for _ in range(n_seeds)] for _ in range(2))
        claim = peak_claim("3D-FCN", HITS, peaks(base, focal))
        said += "larger" in claim.verdict or "smaller" in claim.verdict
    assert said / 300 <= 0.05 + 2 * 0.013


@pytest.mark.parametrize(
    ("shares", "said"),
    [
        ((0.49, 0.50, 0.51), "about half"),
        ((0.89, 0.90, 0.91), "not half"),
        ((0.3, 0.5, 0.7), "not distinguishable from half"),
        ((0.37, 0.38, 0.39), "not distinguishable from half"),
    ],
)
def test_half_is_said_where_all_of_the_interval_is_about_half(
    shares: tuple[float, ...], said: str
) -> None:
    assert half_claim(2.0, [(share, 0.2) for share in shares]).verdict == f"ours: {said}"


def test_the_interval_of_half_is_over_seeds_alone() -> None:
    """By hand: 0.50 and the t of two degrees of freedom, 4.30, times 0.01 over the root of three: 2.5 %."""
    ours = half_claim(2.0, [(share, 0.2) for share in (0.49, 0.50, 0.51)]).ours
    assert ours.endswith("; under γ = 0 [48%, 52%] over seeds; 3 seeds")


def test_without_a_focal_model_nothing_is_said_of_its_loss() -> None:
    assert half_claim(0.0, []).ours == ""


def test_the_hardest_positives_by_hand() -> None:
    """Twenty positives of one logit: the hardest 15 % carry 15 % of the loss."""
    assert hardest_share(np.zeros(20), 2.0) == pytest.approx(HARDEST)
