"""The report's tables, from the report's own cells back to its layout."""

import pandas as pd
import pytest

from fl3d.reports.published import REPORT_TABLES, published_table
from fl3d.reports.recall_tables import NETWORKS, OVERLAPS, recall_table
from fl3d.reports.render import to_latex, to_markdown
from fl3d.reports.table import Table

OVERRIDES = {
    "R1": lambda row: "seed=0",
    "R2": lambda row: f"schedule.stages.rpn.set.schedule.batch_size={row['batch_size']}",
    "R3": lambda row: f"loss.alpha={float(row['alpha_fg']):g}",
    "R4": lambda row: f"detector.rpn={{search:{row['search_range'][:-1]},bin:{row['bin_size'][:-1]}}}",
    "R5": lambda row: f"detector.rcnn.bin={row['rcnn_bin_size'].removesuffix(' m')}",
}


def scores_of_the_report(number: str) -> pd.DataFrame:
    """Scores that say what the report printed: proposals at the first stage's end, refined boxes at the second's."""
    rows = []
    for row in published_table(number).to_dict("records"):
        overrides = OVERRIDES[number](row)
        step = 10 if row.get("network") == NETWORKS[0] else 20
        values = {f"recall_3d/{overlap}": float(row[f"iou_{overlap}"]) for overlap in OVERLAPS}
        front = {"trial": overrides, "overrides": overrides, "step": step, "detector": "PointRCNN"}
        rows.append(front | {"first_own_step": 10 if "network" in row else 0} | values)
    return pd.DataFrame(rows)


def table_of(number: str) -> Table:
    return recall_table(scores_of_the_report(number), number)


@pytest.mark.parametrize("number", REPORT_TABLES)
def test_the_reports_numbers_come_back_beside_themselves(number: str) -> None:
    table, printed = table_of(number), published_table(number)
    assert len(table.rows) == len(printed)
    for overlap in OVERLAPS:
        ours = [float(cell.text) for cell in table.column(f"iou_{overlap}")]
        theirs = [float(cell.text) for cell in table.column(f"iou_{overlap}_published")]
        assert ours == theirs
    fronts = [column.key for column in table.columns if not column.is_number]
    for row, expected in zip(table.rows, printed.to_dict("records"), strict=True):
        assert [cell.text for cell in row[: len(fronts)]] == [expected[key] for key in fronts]


@pytest.mark.parametrize("number", ["R2", "R3", "R4"])
def test_bold_is_the_best_of_a_column_and_the_reports_slips_are_ties(number: str) -> None:
    table = table_of(number)
    for overlap in OVERLAPS:
        ours, theirs = table.column(f"iou_{overlap}"), table.column(f"iou_{overlap}_published")
        best = max(float(cell.text) for cell in ours)
        assert [cell.bold for cell in ours] == [float(cell.text) == best for cell in ours]
        if sum(cell.bold for cell in ours) == 1:
            assert [cell.bold for cell in ours] == [cell.bold for cell in theirs]


def test_another_value_has_no_printed_cell_and_seeds_are_averaged() -> None:
    scores = scores_of_the_report("R2")
    batch = scores["overrides"].str.replace("=16", "=8")
    other = scores.assign(overrides=batch, trial=batch + " seed=1")
    table = recall_table(pd.concat([scores, other]), "R2")
    assert [row[0].text for row in table.rows] == ["8", "16", "32", "64"]
    assert {cell.text for cell in table.rows[0][6:]} == {""}
    twice = scores.assign(trial=scores["trial"] + " seed=1", **{"recall_3d/0.5": 0.0})
    assert recall_table(pd.concat([scores, twice]), "R2").column("iou_0.5")[1].text == "0.415"


def test_it_renders() -> None:
    table = table_of("R5")
    assert to_markdown(table).startswith("**Table 5 of the report.**")
    assert "Box Refinement" in to_latex(table)
