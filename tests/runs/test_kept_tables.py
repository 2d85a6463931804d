"""A table that is kept is the one that would be made now, or it is made again."""

from pathlib import Path

from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.kept_tables import kept_table

TABLE = Table(
    name="VI",
    caption="Layers, of γ",
    columns=(Column("layer", "Layer"), Column("gflops", "GFLOPs", "3D", True)),
    rows=((Cell("conv3d"), Cell("1.0", True, "1.04", True)), (Cell("–"), Cell(""))),
    legend="Star: wrong",
    notes=("Sum: 1.0 GFLOP a frame.",),
    csv_order=("gflops", "layer"),
    title="Table VI.",
    view="published",
)
MADE: list[str] = []


def table() -> Table:
    MADE.append("once")
    return TABLE


def test_a_second_time_it_is_read_and_equal_in_every_part(tmp_path: Path) -> None:
    MADE.clear()
    first, again = (kept_table(tmp_path / "VI.bin", {"torch": "2"}, table) for _ in range(2))
    assert MADE == ["once"]
    assert first == again == TABLE
    assert hash(again) == hash(TABLE)  # tuples all through


def test_what_it_is_made_of_decides(tmp_path: Path) -> None:
    MADE.clear()
    for torch in ("2", "3", "2"):
        kept_table(tmp_path / "VI.bin", {"torch": torch}, table)
    assert len(MADE) == 3


def test_without_a_place_it_is_made_each_time() -> None:
    MADE.clear()
    assert kept_table(None, {}, table) == kept_table(None, {}, table) == TABLE
    assert len(MADE) == 2
