"""Tables say of how many seeds they are means, and compare rows by the seeds that both have."""

import pandas as pd
import pytest

from fl3d.reports.seeds import PAIRED, better_in_pairs, seeds_by, seeds_note


@pytest.mark.parametrize(
    ("seeds", "note"),
    [
        ({"a": [0], "b": [0]}, "One seed of training."),
        ({"a": [0, 1], "b": [1, 0]}, "Mean of 2 seeds of training."),
        (
            {"a": [0, 1, 2], "b": [0, 2]},
            "Mean of 2 to 3 seeds of training, of each row its own; "
            f"rows without all of seeds 0, 1, 2: b (0, 2). {PAIRED}",
        ),
        (
            {"a": [0], "b": [1]},
            "One seed of training, of each row its own; "
            f"rows without all of seeds 0, 1: a (0), b (1). {PAIRED}",
        ),
    ],
)
def test_a_note_says_of_how_many_seeds_and_which_rows_lack_some(
    seeds: dict[str, list[int]], note: str
) -> None:
    assert seeds_note(seeds, PAIRED) == note


def test_seeds_are_told_by_the_text_of_their_rows() -> None:
    frame = pd.DataFrame({"group": ["g", "g"], "level": [0.5, 0.5], "seed": [3, 4]})
    assert seeds_by(frame, ["level"]) == {"0.5": [3, 4]}
    assert seeds_by(frame, ["group", "level"]) == {"g 0.5": [3, 4]}


def test_a_mean_of_other_seeds_is_not_better() -> None:
    """The base is 50 and 90, the row 60 alone: below the base's mean, and above in the seed that both have."""
    base = pd.DataFrame({"seed": [0, 1], "ap": [50.0, 90.0]})
    row = pd.DataFrame({"seed": [0], "ap": [60.0]})
    assert better_in_pairs(row, base, ["ap"]) == [True]
    assert better_in_pairs(base, row, ["ap"]) == [False]
    assert better_in_pairs(row.assign(seed=2), base, ["ap"]) == [False]
