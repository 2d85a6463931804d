"""A table as Markdown, LaTeX, HTML and CSV."""

import csv
import io

from fl3d.reports.levels import SYMBOLS
from fl3d.reports.render import to_csv, to_html, to_latex, to_markdown
from fl3d.reports.table import Cell, Column, Table


def one_cell(cell: Cell, head: str = "γ") -> Table:
    columns = (Column("x", head, "G", True),)
    return Table("any", "a < b", columns, ((cell,),), notes=("<n>",), title="Table X.")


def test_html_escapes_and_marks() -> None:
    text = to_html(one_cell(Cell("1 & 2", bold=True, star=True)))
    assert "a &lt; b" in text
    assert "<td class='number'><b>1 &amp; 2</b><sup>*</sup></td>" in text
    assert "&lt;n&gt;" in text
    assert "<b>Table X.</b>" in text


def test_markdown_marks_and_keeps_its_columns() -> None:
    text = to_markdown(one_cell(Cell("a|b", bold=True, star=True)))
    assert text.startswith("**Table X.** a < b.")
    assert r"| **a\|b**\* |" in text


def test_csv_holds_what_was_not_rounded() -> None:
    table = one_cell(Cell("1e-2", raw="0.01"))
    assert to_csv(table) == "x\n0.01\n"
    assert list(csv.reader(io.StringIO(to_csv(one_cell(Cell("a, b")))))) == [["x"], ["a, b"]]


def test_latex_has_every_letter_that_a_factor_may_be_told_by() -> None:
    text = to_latex(one_cell(Cell("schedule_x & 100 %"), ", ".join(SYMBOLS.values())))
    assert text.isascii()
    assert r"schedule\_x \& 100 \%" in text
    assert r"$\alpha$, $\beta$, $\eta$, $\gamma$" in text


def test_a_table_without_rows_renders() -> None:
    table = Table("any", "nothing", (Column("x", "x"),), ())
    assert to_csv(table) == "x\n"
    for render in (to_html, to_latex, to_markdown):
        assert "nothing" in render(table)
