"""A table as it will be printed: cells of text, columns in groups, notes. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Cell:
    """One cell.

    Args:
        text: as printed.
        bold: whether it is set in bold.
        raw: for CSV, where it differs from the text.
        star: whether it is marked, see the table's legend.
    """

    text: str
    bold: bool = False
    raw: str | None = None
    star: bool = False


@dataclass(frozen=True)
class Column:
    """One column.

    Args:
        key: its name in CSV.
        head: as printed.
        group: printed over several columns: ``BEV``, ``3D`` or none.
        is_number: set to the right.
    """

    key: str
    head: str
    group: str = ""
    is_number: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Args:
        name: files are called after it.
        caption: one sentence, without a full stop.
        columns: in printed order.
        rows: a cell for each column.
        legend: what bold and stars stand for.
        notes: what a reader must know beside the numbers.
        csv_order: keys of the columns in CSV, where that order differs.
        title: printed before the caption, such as ``Table III.``; empty for a table that no paper has.
        view: what kind of view of another table it is: ``published`` or ``intervals``; empty: none.
    """

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    legend: str = ""
    notes: tuple[str, ...] = ()
    csv_order: tuple[str, ...] = ()
    title: str = ""
    view: str = ""

    @property
    def base(self) -> str:
        """Name of the table that this is a view of: ``III`` of ``III_intervals``."""
        return self.name.removesuffix(f"_{self.view}") if self.view else self.name

    def as_view(self, view: str, **changes: Any) -> Table:
        """Another view of this table."""
        return replace(self, name=f"{self.name}_{view}", view=view, **changes)

    def with_notes(self, *notes: str) -> Table:
        """The same with other notes."""
        return replace(self, notes=notes)

    def column(self, key: str) -> tuple[Cell, ...]:
        """The cells of one column."""
        place = [column.key for column in self.columns].index(key)
        return tuple(row[place] for row in self.rows)


def is_better(value: float, than: float) -> bool:
    """The bold rule: the printed number is strictly above the printed one."""
    return float(f"{value:.2f}") > float(f"{than:.2f}")


AP_COLUMNS = {
    f"{view}_{level}": f"ap_{view}/{level}"
    for view in ("bev", "3d")
    for level in ("easy", "moderate", "hard")
}
HEADS = {"easy": "Easy", "moderate": "Mod", "hard": "Hard"}
APS = tuple(
    Column(key, HEADS[key.partition("_")[2]], key.partition("_")[0].upper(), True)
    for key in AP_COLUMNS
)
