"""Tables of any sweep: a row a level, a table a group."""

from collections.abc import Sequence

import pandas as pd
import pytest

from fl3d.reports.levels import (
    Levels,
    ap_columns,
    gains_tables,
    levels_table,
    rescored_tables,
    slug,
)
from fl3d.reports.table import Table, is_better
from fl3d.runs.design import in_order
from tests.reports.frames import tidy_scores

GAMMAS = Levels("gamma", ["0", "0.5", "2", "10"], "0")
TEXTS = Levels("loss", ["original", "enhanced"], "original")
SEVERAL = Levels("alpha, gamma", ["alpha=1, gamma=2", "alpha=0.5, gamma=2"], "alpha=1, gamma=2")
MAPS = Levels("rpn", ["search=3 bin=0.5", "search=2 bin=0.2"], "search=3 bin=0.5")
EVERY = (GAMMAS, TEXTS, SEVERAL, MAPS)


def last_of(levels: Levels, **keywords: Sequence[int]) -> pd.DataFrame:
    """Last models, in an order that is nobody's."""
    scores = tidy_scores(levels.labels, **keywords)
    return scores[scores["step"] == 30].iloc[::-1].reset_index(drop=True)


def texts(table: Table, *keys: str) -> list[list[str]]:
    return [
        [cell.text for cell in row]
        for row in zip(*(table.column(key) for key in keys), strict=True)
    ]


@pytest.mark.parametrize("levels", EVERY, ids=lambda levels: levels.name)
def test_levels_are_told_in_their_order(levels: Levels) -> None:
    table = levels_table(last_of(levels), "VoxelNet", levels, "any", "R40", ("a note",))
    assert [cell.text for cell in table.column("level")] == levels.labels
    assert table.column("3d_easy")[0].text == "15.00"
    assert not any(cell.bold for cell in table.rows[0])
    assert all(cell.bold for row in table.rows[1:] for cell in row[2:])
    assert table.notes == ("a note", "One seed of training.")


def test_numbers_are_in_order_and_texts_as_they_come() -> None:
    assert in_order(["2", "10", "0.5", "0", "2"]) == ["0", "0.5", "2", "10"]
    assert in_order(["1e-3", "0.5", "-1"]) == ["-1", "1e-3", "0.5"]
    assert in_order(["original", "enhanced"]) == ["original", "enhanced"]
    assert in_order(["2", "null", "1"]) == ["2", "null", "1"]


def test_the_average_is_the_one_that_is_named() -> None:
    last = last_of(GAMMAS).assign(**{metric: 77.0 for metric in ap_columns("R40").values()})
    r40 = levels_table(last, "VoxelNet", GAMMAS, "any", "R40")
    r11 = levels_table(last, "VoxelNet", GAMMAS, "any", "R11")
    assert {cell.text for cell in r40.column("bev_hard")} == {"77.00"}
    assert "77.00" not in {cell.text for cell in r11.column("bev_hard")}
    assert (r40.legend.count("R40"), r11.legend.count("R11")) == (1, 1)


def test_seeds_are_averaged_and_counted() -> None:
    last = last_of(GAMMAS, seeds=(0, 1))
    last.loc[(last["level"] == "2") & (last["seed"] == 1), "ap_3d/easy"] += 1.0
    last = last[~((last["level"] == "10") & (last["seed"] == 1))]
    table = levels_table(last, "VoxelNet", GAMMAS, "any", "R11")
    assert texts(table, "level", "seeds") == [["0", "2"], ["0.5", "2"], ["2", "2"], ["10", "1"]]
    assert table.column("3d_easy")[2].text == "19.50"


def test_without_the_baseline_nothing_is_bold() -> None:
    last = last_of(GAMMAS)
    table = levels_table(last[last["level"] != "0"], "VoxelNet", GAMMAS, "any", "R11")
    assert len(table.rows) == 3
    assert not any(cell.bold for row in table.rows for cell in row)


def test_equal_as_printed_is_not_better() -> None:
    assert is_better(50.01, 50.0)
    assert not is_better(50.001, 50.0)
    assert not is_better(49.0, 50.0)


def test_a_greek_factor_has_its_letter_and_another_its_name() -> None:
    assert (GAMMAS.head, GAMMAS.text("2")) == ("γ", "γ = 2")
    assert (TEXTS.head, TEXTS.text("enhanced")) == ("loss", "loss = enhanced")
    assert (SEVERAL.head, SEVERAL.text("alpha=1, gamma=2")) == ("α, γ", "alpha=1, gamma=2")
    nothing = Levels("", ["default"], "default")
    assert nothing.text("default") == "default"
    table = levels_table(last_of(nothing), "VoxelNet", nothing, "any", "R40")
    assert table.columns[0].head == "level"


def gains_frame(levels: Levels) -> pd.DataFrame:
    rows = []
    for group in ("VoxelNet", "3D-FCN"):
        for place, level in reversed(list(enumerate(levels.labels))):
            for average in ("R11", "R40"):
                row = {
                    "group": group,
                    "level": level,
                    "seeds": 2,
                    "metric": "3d",
                    "difficulty": "moderate",
                }
                row |= {
                    "average": average,
                    "marked": place == 1,
                    "one_r11_step": average == "R11",
                }
                row |= {"ap": 50.0 + place, "ap_low": 40.0, "ap_high": 60.0}
                rows.append(row | {"gain": float(place), "gain_low": -1.0, "gain_high": 2.0})
    return pd.DataFrame(rows)


@pytest.mark.parametrize("levels", EVERY, ids=lambda levels: levels.name)
def test_gains_have_a_row_a_level_and_a_table_a_group(levels: Levels) -> None:
    tables = gains_tables(gains_frame(levels), levels, "3d/moderate", "R40")
    assert [table.name for table in tables] == ["gains-3d-fcn", "gains-voxelnet"]
    for table in tables:
        assert [cell.text for cell in table.column("level")] == levels.labels
        assert texts(table, "seeds", "ap", "gain", "mark")[:2] == [
            ["2", "50.00 [40.00, 60.00]", "baseline", ""],
            ["2", "51.00 [40.00, 60.00]", "+1.00 [-1.00, +2.00]", "*"],
        ]
        assert table.columns[3].head == f"gain over {levels.text(levels.baseline)}"
        assert table.legend.startswith("Each interval by itself; *: the gain in R40 differs")
    plain = gains_tables(gains_frame(levels).assign(marked=False), levels, "3d/moderate", "R40")
    assert {table.legend for table in plain} == {"Each interval by itself"}


def test_gains_of_fewer_seeds_than_the_baselines_are_told() -> None:
    frame = gains_frame(GAMMAS)
    frame.loc[(frame["group"] == "3D-FCN") & (frame["level"] == "10"), "seeds"] = 1
    told, plain = gains_tables(frame, GAMMAS, "3d/moderate", "R40")
    assert told.notes[0].endswith("the two APs for γ = 10 (1 of 2).")
    assert plain.notes == ()


def test_one_recall_step_is_marked() -> None:
    table = gains_tables(gains_frame(GAMMAS), GAMMAS, "3d/moderate", "R11")[0]
    assert [cell.text for cell in table.column("mark")] == [
        "one R11 step",
        "* one R11 step",
        *["one R11 step"] * 2,
    ]


def rescored(levels: Levels, changes: Sequence[dict[str, str]]) -> pd.DataFrame:
    rows = []
    for group in ("3D-FCN", "VoxelNet"):
        for place, level in reversed(list(enumerate(levels.labels))):
            for seed in (0, 1):
                for number, change in enumerate(changes):
                    ap = 10.0 * place + number + seed
                    rows.append(
                        {
                            "group": group,
                            "level": level,
                            "seed": seed,
                            **change,
                            "ap_3d/moderate": ap,
                        }
                    )
    return pd.DataFrame(rows)


@pytest.mark.parametrize("levels", EVERY, ids=lambda levels: levels.name)
def test_rescored_aps_stand_by_level_and_value_and_seeds_are_averaged(levels: Levels) -> None:
    changes = [
        {"nms_iou": value} for value in ("0.5", "0.01")
    ]  # in the order in which they were asked for
    tables = rescored_tables(rescored(levels, changes), levels, ["nms_iou"], "ap_3d/moderate")
    assert [table.name for table in tables] == ["rescored-3d-fcn", "rescored-voxelnet"]
    table = tables[0]
    assert [column.head for column in table.columns] == [levels.head, "0.5", "0.01"]
    assert [cell.text for cell in table.column("level")] == levels.labels
    assert texts(table, "value_0", "value_1")[:2] == [["0.50", "1.50"], ["10.50", "11.50"]]


def test_two_changed_values_share_a_column() -> None:
    pairs = [("0", "standup"), ("0", "3d"), ("0.5", "standup"), ("0.5", "3d")]
    changes = [{"score_threshold": cut, "nms_kind": kind} for cut, kind in pairs]
    keys = ["score_threshold", "nms_kind"]
    (table, _) = rescored_tables(rescored(GAMMAS, changes), GAMMAS, keys, "ap_3d/moderate")
    assert [column.head for column in table.columns[1:]] == [
        "0, standup",
        "0, 3d",
        "0.5, standup",
        "0.5, 3d",
    ]
    assert [cell.text for cell in table.column("level")] == GAMMAS.labels
    assert [cell.text for cell in table.rows[1]] == ["0.5", "10.50", "11.50", "12.50", "13.50"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("VoxelNet", "voxelnet"),
        ("3D-FCN, alpha=0.5", "3d-fcn-alpha-0-5"),
        ("F-ConvNet", "f-convnet"),
        ("VoxelNet, z=-1", "voxelnet-z-minus1"),
        ("VoxelNet, lr=1e-05", "voxelnet-lr-1e-05"),
    ],
)
def test_a_label_becomes_part_of_a_file_name(text: str, expected: str) -> None:
    assert slug(text) == expected
