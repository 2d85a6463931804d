"""Tables of a comparison of detectors."""

import numpy as np
import pandas as pd
import pytest

from fl3d.reports.comparison import Shown, ap_table, gain_table, verdict_table
from fl3d.reports.render import to_latex, to_text
from fl3d.reports.table import Cell, Column, Table

SHOWN = Shown(("base", "other", "flat"), "base", 1.0, ("A note.",))


def verdicts(**changes: object) -> pd.DataFrame:
    base = {"group": "Car", "metric": "3d_r40/moderate", "level": "base", "seeds": 3}
    base |= {"ap": 70.0, "ap_low": 68.0, "ap_high": 72.0}
    base |= {"gain": 0.0, "gain_low": 0.0, "gain_high": 0.0}
    base |= {"verdict": "baseline", "more_seeds": np.nan}
    other = {**base, "level": "other", "ap": 71.0, "gain": 1.0, "gain_low": -1, "gain_high": 3}
    return pd.DataFrame([base, {**other, **changes}])


@pytest.mark.parametrize(
    ("changes", "word", "note"),
    [
        ({"verdict": "better", "gain_low": 0.5}, "better", None),
        ({"verdict": "undecided", "more_seeds": 4.0}, "undecided", "undecided, about 4 more runs"),
        ({"verdict": "undecided"}, "undecided", "undecided; runs alone would probably not tell"),
        ({"verdict": "none", "seeds": 1}, "frames only, not training", None),
        (
            {"verdict": "none", "seeds": 2, "more_seeds": 1.0},
            "no verdict before 3 runs",
            "no verdict before 3 runs, about 1 more run",
        ),
        ({"verdict": "equivalent", "gain_high": 0.4}, "equivalent within 1 AP", None),
    ],
)
def test_a_verdict_is_short_and_what_would_bring_one_stands_below(
    changes: dict[str, object], word: str, note: str | None
) -> None:
    table = verdict_table(verdicts(**changes), "Car", SHOWN)
    assert [row[-1].text for row in table.rows] == ["baseline", word, "no 3D boxes"]
    if note is None:
        assert table.notes == ("A note.",)
    else:
        assert table.notes[0].startswith(f"other: {note}")
    assert max(map(len, to_text(table).splitlines())) <= 100


def cells() -> pd.DataFrame:
    """3D of two detectors, 2D of three; gain 1 everywhere, the last cell marked."""
    rows = []
    for name in SHOWN.names:
        for metric in ("image", "3d"):
            for place, difficulty in enumerate(("easy", "moderate", "hard")):
                for average in ("R11", "R40"):
                    has = name != "flat" or metric == "image"
                    ap = (70.0 if name == "base" else 71.0) if has else np.nan
                    gain = 1.0 if has and name != "base" else np.nan
                    row = {"class": "Car", "metric": metric, "difficulty": difficulty}
                    row |= {"average": average, "detector": name, "n_gt": 100 + place, "runs": 3}
                    row |= {"ap": ap, "gain": gain, "gain_low": gain - 2, "gain_high": gain + 2}
                    is_marked = (name, metric, place, average) == ("other", "3d", 2, "R40")
                    rows.append(row | {"marked": is_marked, "one_r11_step": False})
    return pd.DataFrame(rows)


def test_aps_as_papers_print_them() -> None:
    table = ap_table(cells(), "Car", "R40", SHOWN)
    assert [column.group for column in table.columns] == ["", *["3D"] * 3, *["2D"] * 3]
    base, other, flat = table.rows
    assert [cell.text for cell in flat] == ["flat", "–", "–", "–", "71.00", "71.00", "71.00"]
    assert all(cell.bold for cell in other[1:])
    assert not any(cell.bold for cell in base)
    assert [cell.star for cell in other[1:]] == [False, False, True, False, False, False]
    assert "ground truths: 100 / 101 / 102" in table.caption
    assert "Star: differs from zero" in table.legend


def test_gains_leave_out_who_has_no_boxes() -> None:
    table = gain_table(cells(), "Car", SHOWN)
    assert len(table.rows) == 3 * 2 + 3 * 3
    assert [cell.text for cell in table.rows[0]] == [
        *("3D easy", "100", "base", "70.00", "baseline", "70.00", "baseline")
    ]
    assert table.rows[1][4].text == "+1.00 [-1.00, +3.00]"
    assert max(map(len, to_text(gain_table(cells(), "Car", SHOWN, narrow=True)).splitlines())) < 100


def test_text_is_markdown_with_columns_below_each_other() -> None:
    columns = (Column("a", "name"), Column("b", "n", "", True))
    table = Table(
        "t", "Caption", columns, ((Cell("x|y"), Cell("1")), (Cell("z", True), Cell("22")))
    )
    assert to_text(table) == (
        "Caption.\n\n| name  |   n |\n| ----- | --: |\n| x\\|y  |   1 |\n| **z** |  22 |\n"
    )


def test_latex_has_no_bare_special_letter() -> None:
    columns = (Column("a", r"\ { } ~ ^ _ % & # $"),)
    line = to_latex(Table("t", "C", columns, ())).splitlines()[7]
    assert line == (
        r"\textbackslash{} \{ \} \textasciitilde{} \textasciicircum{} \_ \% \& \# \$ \\"
    )
