"""What a cut of scores costs the focal loss, by hand arithmetic and in words."""

import pytest

from fl3d.papers.focal_loss.cut_claim import cut_claim
from fl3d.reports.verdicts import ONE_SEED


def test_what_comes_back_is_the_gain_without_a_cut_less_that_at_the_cut() -> None:
    """Gains of γ = 5: −1, −1, −1 without a cut and −4, −3, −5 at it: 3, 2 and 4 come back, 3 on average.

    Their standard deviation is 1, so t of two degrees of freedom gives 3 ± 4.303 / sqrt(3) = 3 ± 2.48.
    """
    zero = {seed: (50.0, 50.0) for seed in range(3)}
    five = {0: (49.0, 46.0), 1: (49.0, 47.0), 2: (49.0, 45.0)}
    claim = cut_claim("3D-FCN", {0.0: zero, 2.0: zero, 5.0: five})
    assert claim.ours == (
        "γ = 5 gains -4.00 AP at the cut, -1.00 without: +3.00 [+0.52, +5.48] over seeds; 3 seeds"
    )
    assert claim.verdict == "ours: larger"


@pytest.mark.parametrize(
    ("aps", "verdict"),
    [
        ({}, ""),
        ({0.0: {0: (50.0, 50.0)}}, ""),
        ({0.0: {0: (50.0, 50.0)}, 5.0: {1: (49.0, 45.0)}}, ""),
        ({0.0: {0: (50.0, 50.0)}, 5.0: {0: (49.0, 45.0)}}, f"ours: {ONE_SEED}"),
    ],
    ids=["nothing", "no focal loss", "no common seed", "one seed"],
)
def test_without_pairs_of_three_seeds_nothing_is_judged(
    aps: dict[float, dict[int, tuple[float, float]]], verdict: str
) -> None:
    assert cut_claim("VoxelNet", aps).verdict == verdict
