"""A table with an interval in each cell."""

import pandas as pd
import pytest

from fl3d.reports.intervals import with_intervals
from fl3d.reports.levels import Levels, levels_table
from fl3d.reports.render import to_markdown
from fl3d.reports.table import Cell
from tests.papers.published_tables import papers_table
from tests.reports.frames import tidy_scores


def gain_rows(row: str, seeds: int = 2) -> pd.DataFrame:
    front = {
        "row": row,
        "metric": "3d",
        "difficulty": "moderate",
        "seeds": seeds,
        "ap_high": 30.0,
        "significant": True,
    }
    rows = [
        front | {"average": average, "ap_low": low, "one_r11_step": average == "R11"}
        for average, low in (("R11", 25.04), ("R40", 1.0))
    ]
    return pd.DataFrame(rows)


def test_intervals_stand_behind_each_cell_and_significant_gains_have_stars() -> None:
    view = with_intervals(papers_table("II"), gain_rows("2"), "better than γ = 0")
    cell = view.column("3d_moderate")[5]
    assert cell == Cell("27.23 [25.0, 30.0] †", bold=True, star=True)
    assert view.column("3d_moderate")[0].text == "21.96"  # no gain was given for it
    assert "frames and 2 seeds" in view.notes[-2]
    assert r"**27.23 [25.0, 30.0] †**\*" in to_markdown(view)
    assert (view.name, view.base) == ("II_intervals", "II")


def test_intervals_of_one_seed_are_over_frames_alone() -> None:
    view = with_intervals(
        papers_table("II"), gain_rows("2", seeds=1), "better than γ = 0", average="R40"
    )
    assert view.notes == ("Intervals over frames.",)  # R40 has no step worth a dagger
    assert view.column("3d_moderate")[5].text == "27.23 [1.0, 30.0]"


def test_rows_told_by_two_columns_are_found() -> None:
    view = with_intervals(
        papers_table("IV"), gain_rows("VoxelNet 0.2"), "better than γ = 0", key_columns=2
    )
    assert [cell.star for cell in view.column("3d_moderate")] == [False, False, False, True]


@pytest.mark.parametrize(
    "labels", [["original", "enhanced"], ["alpha=1, beta=5", "alpha=2, beta=5"]]
)
def test_a_table_of_any_levels_takes_them(labels: list[str]) -> None:
    levels = Levels("any", labels, labels[0])
    table = levels_table(tidy_scores(labels), "VoxelNet", levels, "any", "R40")
    view = with_intervals(table, gain_rows(labels[1]), "better", average="R40")
    assert [cell.star for cell in view.column("3d_moderate")] == [False, True]
    assert view.column("3d_moderate")[1].text.endswith(" [1.0, 30.0]")
