"""A table beside the published one: what agrees, and what was printed."""

from dataclasses import replace

import pytest

from fl3d.papers.beside import Agreement, Published, agreement, beside, summary
from fl3d.papers.focal_loss.best_models import BEST_MODELS
from fl3d.papers.focal_loss.tables import LAST_3D_FCN, LAST_VOXELNET, LOSS_FORMS
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Column, Table
from tests.papers.published_tables import papers_table

TABLES = {table.number: table for table in (LAST_3D_FCN, LAST_VOXELNET, BEST_MODELS, LOSS_FORMS)}


def view_of(table: Table) -> Table:
    view = TABLES[table.name].beside(table)
    assert view is not None
    return view


@pytest.mark.parametrize("number", TABLES)
def test_the_papers_own_numbers_agree_with_themselves(number: str) -> None:
    table = papers_table(number)
    view = view_of(table)
    is_ordered = number in ("II", "III")
    n_summary = 3 if is_ordered else 2
    assert len(view.rows) == len(table.rows) + n_summary
    for column in AP_COLUMNS:
        theirs = [cell.text.partition(" ")[0] for cell in view.column(f"{column}_published")]
        assert [cell.text for cell in table.column(column)] == theirs[:-n_summary]
        assert {cell.text for cell in view.column(f"{column}_difference") if cell.text} == {"+0.00"}
        signs, bolds, *rank = [cell.text for cell in view.column(column)[-n_summary:]]
        n_gains = len(table.rows) - (2 if number == "IV" else 1)
        assert signs == bolds == f"{n_gains}/{n_gains}"
        assert rank == (["+1.00"] if is_ordered else [])


def test_gains_of_other_sign_are_counted() -> None:
    """3D-FCN, BEV easy: of six gains five are positive, 5.42 to 11.21 but for 1.48.

    All ours lie 6 lower.
    """
    view = view_of(papers_table("II", shift=-6.0))
    assert [cell.text for cell in view.column("bev_easy")[-3:-1]] == ["3/6", "6/6"]


def one_column_table(*texts: str) -> tuple[Table, list[str]]:
    """A table of rows ``0``, ``1`` and so on, all its APs alike."""
    rows = tuple((Cell(str(key)), *[Cell(text)] * 6) for key, text in enumerate(texts))
    return Table("any", "", (Column("key", "key"), *APS), rows), [
        str(key) for key in range(len(texts))
    ]


def published(*texts: str, is_ordered: bool = True) -> Published:
    rows = {
        str(key): {column: text for column in AP_COLUMNS}
        | {f"{column}_bold": "0" for column in AP_COLUMNS}
        for key, text in enumerate(texts)
    }
    return Published(rows=rows, base_of=lambda key: "0", is_ordered=is_ordered)


def test_agreement_by_hand() -> None:
    """Gains of ours: +1, 0, -1; the paper's: +2, -1, -3. Two of three have the same sign."""
    table, keys = one_column_table("5", "6", "5", "4")
    found = agreement(table, keys, published("5", "7", "4", "2"), "3d_easy")
    assert (found.signs, found.bolds, found.rows) == (2, 3, 3)
    ranks = (found.rank or 0.0) ** 2
    assert ranks == pytest.approx(
        4.5**2 / (4.5 * 5)
    )  # ours tie once: ranks 2.5, 4, 2.5, 1 against 3, 4, 2, 1


def test_an_order_of_less_than_three_rows_says_nothing() -> None:
    table, keys = one_column_table("5", "6")
    assert agreement(table, keys, published("5", "7"), "3d_easy").rank is None
    table, keys = one_column_table("5", "6", "7")
    assert (
        agreement(table, keys, published("5", "6", "7", is_ordered=False), "3d_easy").rank is None
    )


def test_a_summary_without_rows_shows_dashes() -> None:
    found = summary([Agreement(0, 0, 0, None), Agreement(1, 2, 3, 0.5)])
    assert found == {
        "gains of the same sign": ["–", "1/3"],
        "bold alike": ["–", "2/3"],
        "rank correlation ρ": ["–", "+0.50"],
    }


def test_rows_that_were_not_published_are_left_out() -> None:
    table, _ = one_column_table("5", "6")
    assert beside(table, ["x", "y"], published("5", "7")) is None
    view = beside(table, ["x", "1"], published("5", "7"))
    assert view is not None
    assert [row[0].text for row in view.rows] == ["1", "gains of the same sign", "bold alike"]
    printed = papers_table("II")
    assert LAST_3D_FCN.beside(replace(printed, rows=((Cell("3"), *[Cell("1.00")] * 6),))) is None


def test_the_arxiv_version_shows_where_it_differs() -> None:
    view = view_of(papers_table("IV"))
    assert view.column("3d_moderate_published")[2].text == "58.09 (57.84)"
    assert view.column("3d_moderate_published")[3].text == "58.39"
    assert "arXiv" in view.notes[-2]
    assert "VoxelNet γ = 0.2, lr 1e-4, step 215k" in view.notes[-1]


def test_the_best_focal_model_stands_beside_the_papers_whatever_its_gamma() -> None:
    table = papers_table("IV")
    rows = [list(row) for row in table.rows]
    rows[1][1] = Cell("0.5")
    view = view_of(replace(table, rows=tuple(tuple(row) for row in rows)))
    assert view.column("bev_easy_published")[1].text == "53.19"


def test_a_view_knows_the_table_that_it_is_of() -> None:
    view = view_of(papers_table("III"))
    assert (view.name, view.base, view.title) == ("III_published", "III", "Table III.")
