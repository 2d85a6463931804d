"""The report's tables, from the report's own cells back to its layout."""

import pandas as pd
import pytest

from fl3d.reports.published import published_table
from fl3d.reports.recall_tables import LAYOUTS, NETWORKS, OVERLAPS, recall_table
from fl3d.reports.render import to_latex, to_markdown
from fl3d.reports.report_tables import KITTI_LEVEL, LEVELS, SETTINGS, detectors_table, frustum_table
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


@pytest.mark.parametrize("number", LAYOUTS)
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
        differ = len({cell.text for cell in ours}) > 1
        assert [cell.bold for cell in ours] == [differ and float(cell.text) == best for cell in ours]
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


def scores_of_the_frustum_table() -> pd.DataFrame:
    """Scores that say what Table 6 printed, as its sweeps leave them: first stages alone, and two trials of both."""
    rows = []
    for row in published_table("R6").to_dict("records"):
        overrides = SETTINGS[row["stage"], row["setting"]]
        values = {f"ap_3d/{KITTI_LEVEL[level]}": float(row[f"3d_{level}"]) for level in LEVELS}
        two = row["stage"] == "refinement" or row["setting"] == "Default Parameters"
        step = 20 if row["stage"] == "refinement" else 10
        front = {"trial": f"{overrides} {two}", "overrides": overrides, "step": step, "seed": 0}
        rows.append(front | {"detector": "F-ConvNet", "first_own_step": 10 if two else 0} | values)
    return pd.DataFrame(rows)


def test_table_6_comes_back_from_its_own_cells() -> None:
    scores = scores_of_the_frustum_table()
    seeds = [scores.assign(seed=k, trial=scores["trial"] + str(k)) for k in (0, 1)]
    seeds = [own.assign(overrides=own["overrides"] + f" seed={k}") for k, own in enumerate(seeds)]
    assert frustum_table(pd.concat(seeds)) == frustum_table(scores)
    table, printed = frustum_table(scores), published_table("R6")
    assert [cell.text for cell in table.column("setting")] == list(printed["setting"])
    for level in LEVELS:
        ours, theirs = table.column(f"3d_{level}"), table.column(f"3d_{level}_published")
        assert [cell.text for cell in ours] == [cell.text for cell in theirs]
        wrong = [a.bold != b.bold for a, b in zip(ours, theirs, strict=True)]
        assert sum(wrong) == (1 if level == "easy" else 0)  # the report forgot one bold: its final row, easy


def test_table_7_chooses_the_final_models_and_bolds_the_better() -> None:
    keys = [f"ap_{metric}/{level}" for metric in ("image", "bev", "3d") for level in ("easy", "moderate", "hard")]
    rows = [
        ("PointRCNN", "detector.rcnn.bin=0.5", 50.0),
        ("PointRCNN", "detector.rcnn.bin=0.3", 60.0),
        ("F-ConvNet", "loss.alpha=0.25", 90.0),
        ("F-ConvNet", "loss.alpha=0.3", 55.0),
    ]
    scores = pd.DataFrame(
        [
            {"trial": f"{d} {o}", "overrides": o, "step": 20, "first_own_step": 10, "seed": 0, "detector": d}
            | dict.fromkeys(keys, value)
            for d, o, value in rows
        ]
    )
    table = detectors_table(scores)
    assert [[cell.text for cell in row[:3]] for row in table.rows] == [
        ["PointRCNN", "ours", "60.0"],
        ["", "report", "89.6"],
        ["Frustum ConvNet", "ours", "55.0"],
        ["", "report", "98.7"],
    ]
    assert [row[2].bold for row in table.rows] == [True, False, False, True]
    assert len(detectors_table(scores[scores["detector"] == "PointRCNN"]).rows) == 2
