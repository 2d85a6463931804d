"""What a sweep without tables prints."""

import pandas as pd

from fl3d.reports.table import AP_COLUMNS
from fl3d.results import summary


def test_trials_are_told_in_the_order_they_were_asked_for() -> None:
    rows = [
        {"trial": trial, "step": step, "first_own_step": 0} | dict.fromkeys(AP_COLUMNS.values(), ap)
        for trial, step, ap in (("a", 1, 30.0), ("a", 2, 20.0), ("b", 1, 10.0), ("b", 2, 40.0))
    ]
    lines = summary(pd.DataFrame(rows), {"b": "loss.gamma=0", "a": "loss.gamma=2"}, "last").strip().splitlines()[2:]
    told = [[cell.strip() for cell in line.split("|")[1:5]] for line in lines]
    assert told == [
        ["loss.gamma=0", "last", "2", "40.00"],
        ["loss.gamma=2", "last", "2", "20.00"],
        ["loss.gamma=0", "best", "2", "40.00"],
        ["loss.gamma=2", "best", "1", "30.00"],
    ]
