"""Last, best and honest best, side by side."""

import pandas as pd
import pytest

from fl3d.reports.halves import halves_table
from fl3d.reports.levels import Levels
from fl3d.reports.render import to_markdown
from fl3d.reports.table import AP_COLUMNS
from tests.reports.frames import tidy_scores


def test_last_best_and_honest_best_stand_side_by_side() -> None:
    rows = []
    for step, ap in ((5, 90.0), (10, 50.0), (20, 70.0), (30, 60.0)):  # the first is shared
        front = {
            "trial": "a",
            "group": "VoxelNet",
            "level": "0",
            "seed": 0,
            "step": step,
            "first_own_step": 5,
        }
        rows.append(front | dict.fromkeys(AP_COLUMNS.values(), ap))
    scores = pd.DataFrame(rows)
    halved = pd.DataFrame([{"trial": "a", "chosen": 72.0, "other": 66.0}])
    last = scores[scores["step"] == 30]
    best = scores[scores["step"] == 20]
    table = halves_table(scores, last, best, halved, Levels("gamma", ["0"], "0"), ("a note",))
    texts = ["VoxelNet", "0", "60.00", "60.00", "70.00", "72.00", "66.00", "+6.00"]
    assert [[cell.text for cell in row] for row in table.rows] == [texts]
    assert [column.head for column in table.columns[1:4]] == ["γ", "last", "mean of last 3"]
    assert table.notes == (
        "a note",
        "Best is chosen among 3 checkpoints of a trial's last stage.",
        "One seed of training.",
    )
    assert to_markdown(table).startswith("Last, best and honest best")


def test_of_unlike_numbers_of_checkpoints_the_mean_of_the_last_few_says_of_how_many() -> None:
    """Seed 0 has three checkpoints, seed 1 two."""
    scores = tidy_scores(["0"], ["VoxelNet"], (0, 1))
    scores = scores[(scores["seed"] == 0) | (scores["step"] != 10)]
    last = scores[scores["step"] == 30]
    halved = pd.DataFrame({"trial": last["trial"], "chosen": 1.0, "other": 1.0})
    table = halves_table(scores, last, last, halved, Levels("gamma", ["0"], "0"))
    assert table.columns[3].head == "mean of last 2 to 3"
    assert "among 2/3 checkpoints" in table.notes[0]


@pytest.mark.parametrize("labels", [["10", "0.5", "2"], ["original", "enhanced"]])
def test_levels_keep_their_order_and_seeds_are_averaged(labels: list[str]) -> None:
    scores = tidy_scores(labels, seeds=(0, 1))
    last = scores[scores["step"] == 30]
    best = scores[scores["step"] == 20]
    chosen = last["seed"].to_numpy() * 10.0
    halved = pd.DataFrame({"trial": last["trial"].to_numpy(), "chosen": chosen, "other": 0.0})
    table = halves_table(scores, last, best, halved, Levels("loss", labels, labels[0]))
    assert [row[1].text for row in table.rows] == [*labels, *labels]
    assert [row[0].text for row in table.rows] == ["3D-FCN"] * len(labels) + ["VoxelNet"] * len(
        labels
    )
    assert {row[-1].text for row in table.rows} == {"+5.00"}
