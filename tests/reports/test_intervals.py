"""A table with an interval in each cell."""

import pandas as pd
import pytest

from fl3d.reports.intervals import with_intervals
from fl3d.reports.levels import Levels, levels_table
from fl3d.reports.render import to_markdown
from fl3d.reports.table import Cell
from tests.papers.published_tables import papers_table
from tests.reports.frames import tidy_scores

WORDS = {"0": "baseline", "2": "better"}


def gain_rows(
    row: str, marked: bool = True, gain: float = 2.0, seeds_done: int = 3
) -> pd.DataFrame:
    front = {
        "row": row,
        "metric": "3d",
        "difficulty": "moderate",
        "seeds": 3,
        "seeds_done": seeds_done,
        "ap": 27.5,
        "ap_high": 30.0,
        "gain": gain,
        "marked": marked,
    }
    rows = [
        front | {"average": average, "ap_low": low, "one_r11_step": average == "R11"}
        for average, low in (("R11", 25.04), ("R40", 1.0))
    ]
    return pd.DataFrame(rows)


def test_intervals_stand_behind_each_cell_marked_gains_have_stars_and_each_row_its_verdict() -> (
    None
):
    view = with_intervals(papers_table("II"), gain_rows("2"), "better than γ = 0", verdicts=WORDS)
    cell = view.column("3d_moderate")[5]
    assert cell == Cell("27.50 [25.0, 30.0] †", bold=True, star=True)
    assert view.column("3d_moderate")[0].text == "21.96"  # no gain was given for it
    assert r"**27.50 [25.0, 30.0] †**\*" in to_markdown(view)
    assert (view.name, view.base) == ("II_intervals", "II")
    assert view.columns[-1].head == "verdict"
    assert [cell.text for cell in view.column("verdict")] == [
        "baseline",
        *[""] * 4,
        "better",
        "",
    ]
    assert "star: the gain in R40 differs from zero" in view.legend
    assert view.notes[-1].startswith(
        "†: R11 moves more than twice as far as R40, or the other way: "
    )


def test_the_cell_is_the_ap_of_the_seeds_that_its_interval_is_over() -> None:
    """27.23 is the table's own, of all seeds; 27.50 the gains'."""
    table = papers_table("II")
    assert table.column("3d_moderate")[5].text == "27.23"
    view = with_intervals(table, gain_rows("2"), "better", verdicts=WORDS)
    assert view.column("3d_moderate")[5].text.startswith("27.50 [")


def test_a_row_with_seeds_that_the_baseline_lacks_says_of_how_many_its_cells_are() -> None:
    view = with_intervals(papers_table("II"), gain_rows("2", seeds_done=5), "better")
    note = "Here APs are, as their intervals, of the seeds that the baseline has too (2: 3 of 5)."
    assert view.notes[-2] == note
    levels = Levels("any", ["original", "enhanced"], "original")
    scores = tidy_scores(levels.labels, seeds=range(5))
    table = levels_table(scores[scores["step"] == 30], "VoxelNet", levels, "any", "R40")
    assert [cell.text for cell in table.column("seeds")] == ["5", "5"]
    rows = gain_rows("enhanced", seeds_done=5)
    view = with_intervals(table, rows, "better", average="R40")
    assert [cell.text for cell in view.column("seeds")] == ["5", "3"]
    assert view.column("3d_moderate")[1].text == "27.50 [1.0, 30.0]"


def test_bold_is_by_the_gain_that_the_cell_is_printed_with() -> None:
    table = papers_table("II")
    for gain, is_bold in ((0.01, True), (0.001, False), (-1.0, False)):
        view = with_intervals(table, gain_rows("2", gain=gain), "better", verdicts=WORDS)
        assert view.column("3d_moderate")[5].bold == is_bold


def test_without_a_marked_gain_the_legend_has_no_star() -> None:
    view = with_intervals(
        papers_table("II"), gain_rows("2", marked=False), "better than γ = 0", verdicts=WORDS
    )
    assert not any(cell.star for row in view.rows for cell in row)
    assert view.legend == "AP in percent [95 % interval]; bold: better than γ = 0"


def test_r40_has_no_step_worth_a_dagger() -> None:
    view = with_intervals(papers_table("II"), gain_rows("2"), "better", average="R40")
    assert view.notes == papers_table("II").notes
    assert view.column("3d_moderate")[5].text == "27.50 [1.0, 30.0]"


def test_a_table_without_verdicts_marks_nothing_and_keeps_its_bold() -> None:
    """Table IV: the best checkpoint and gamma were chosen on these frames."""
    table = papers_table("IV")
    view = with_intervals(
        table, gain_rows("VoxelNet 0.2", gain=-5.0), "better than γ = 0", key_columns=2
    )
    own = view.column("3d_moderate")
    assert [cell.text.endswith("†") for cell in own] == [False, False, False, True]
    assert [cell.bold for cell in own] == [cell.bold for cell in table.column("3d_moderate")]
    assert not any(cell.star for row in view.rows for cell in row)
    assert [column.key for column in view.columns] == [column.key for column in table.columns]
    assert "star" not in view.legend


@pytest.mark.parametrize(
    "labels", [["original", "enhanced"], ["alpha=1, beta=5", "alpha=2, beta=5"]]
)
def test_a_table_of_any_levels_takes_them(labels: list[str]) -> None:
    levels = Levels("any", labels, labels[0])
    table = levels_table(tidy_scores(labels), "VoxelNet", levels, "any", "R40")
    words = dict(zip(labels, ("baseline", "undecided"), strict=True))
    view = with_intervals(table, gain_rows(labels[1]), "better", average="R40", verdicts=words)
    assert [cell.star for cell in view.column("3d_moderate")] == [False, True]
    assert view.column("3d_moderate")[1].text.endswith(" [1.0, 30.0]")
    assert [cell.text for cell in view.column("verdict")] == ["baseline", "undecided"]
