"""Tables I, VI and VII: computed from what is built, the printed numbers beside."""

import pytest

from fl3d.config.compose import compose_config
from fl3d.inference.load import build_detector
from fl3d.papers.course_report import published_cells as report_cells
from fl3d.papers.focal_loss.layers import DETECTORS, layer_table, still_tables
from fl3d.papers.focal_loss.published_cells import ARXIV, TABLES, published_table
from fl3d.reports.table import Table


@pytest.fixture(scope="module")
def full_size() -> dict[str, Table]:
    return {table.name: table for table in still_tables(lambda _: None)}


def test_tables_that_need_no_training_are_these(full_size: dict[str, Table]) -> None:
    assert list(full_size) == ["I", *DETECTORS]
    assert [table.title for table in full_size.values()] == ["Table I.", "Table VI.", "Table VII."]


@pytest.mark.parametrize("number", DETECTORS)
def test_layers_as_printed_but_for_the_papers_slips(
    full_size: dict[str, Table], number: str
) -> None:
    table = full_size[number]
    printed = published_table(number)
    printed = printed[printed["gflops"] != "/"]
    for row, expected in zip(table.rows, printed.to_dict("records"), strict=True):
        block, layer, kernel, strides, filters, own, theirs, *_, note = row
        assert (block.text, kernel.text, strides.text) == (
            expected["block"],
            expected["kernel"],
            expected["strides"],
        )
        assert filters.text == expected["filters"]
        assert (
            expected["layer"].startswith(layer.text.split("_")[0])
            or layer.text == expected["layer"]
        )
        assert theirs.text == expected["gflops"]
        assert theirs.star == bool(note.text)
        if not theirs.star and "<" not in theirs.text:
            assert own.text == theirs.text
    assert sum(cell.star for cell in table.column("published")) == {"VI": 0, "VII": 7}[number]
    assert all("counted" in cell.text for cell in table.column("note") if cell.text)


def test_layers_of_the_arxiv_version_stand_beside(full_size: dict[str, Table]) -> None:
    cells = full_size["VII"].column("arxiv")
    right = ["<0.1", "311.5", "93.5", "62.3", "10.4", "31.2", "20.8", "13.0", "0.1", "0.8"]
    assert [cell.text for cell in cells if not cell.star] == right
    assert [cell.text for cell in cells if cell.star] == [
        "<0.1",
        "<0.1",
        "10.4",
        "34.0",
        "5.2",
        "5.2",
        "2.6",
    ]
    assert "arxiv" not in [column.key for column in full_size["VI"].columns]


def test_another_network_has_no_printed_number_beside_it() -> None:
    config = compose_config(["detector=fcn3d", "profile=paper", "detector.head_bias=true"])
    table = layer_table("VII", lambda: build_detector(config))
    assert {cell.text for cell in table.column("published")} == {""}


def test_every_published_table_can_be_read() -> None:
    for name in (*TABLES, *ARXIV.values()):
        assert len(published_table(name)) > 0
    for number in range(1, 8):
        assert len(report_cells.published_table(f"R{number}")) > 0
