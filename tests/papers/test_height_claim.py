"""Whether the imbalance of windows grows with their height, by hand arithmetic."""

import pandas as pd

from fl3d.papers.focal_loss.height_claim import height_claim


def test_steps_up_in_which_the_imbalance_grows_are_counted() -> None:
    """A height without a positive says nothing; 999 / 1, 90 / 10, 98 / 2 fall once and rise once."""
    windows = pd.DataFrame(
        {
            "z_low": [0.0, -2.0, -1.0, 1.0],
            "positives": [2.0, 1.0, 10.0, 0.0],
            "negatives": [98.0, 999.0, 90.0, 100.0],
        }
    )
    claim = height_claim(windows)
    assert claim.ours == "999, 9, 49"
    assert claim.verdict == "ours: increases in 1 of 2 steps"


def test_one_height_says_nothing() -> None:
    windows = pd.DataFrame({"z_low": [0.0], "positives": [1.0], "negatives": [9.0]})
    assert height_claim(windows).verdict == ""
