"""A table as it will be printed: cells of text, columns in groups, notes. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cell:
    """One cell.

    Args:
        text: as printed.
        bold: whether it is set in bold.
        raw: for CSV, where it differs from the text.
        star: whether the table's certain gains are marked here.
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
        name: ``II``, or ``II_published`` for another view of it: files are called after it.
        caption: one sentence, without a full stop.
        columns: in printed order.
        rows: a cell for each column.
        legend: what bold and stars stand for.
        notes: what a reader must know beside the numbers.
        csv_order: keys of the columns in CSV, where that order differs.
    """

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    legend: str = ""
    notes: tuple[str, ...] = ()
    csv_order: tuple[str, ...] = ()

    @property
    def number(self) -> str:
        """Of the paper's table: ``II``; of a table that the paper has not, its name."""
        return self.name.partition("_")[0]

    @property
    def title(self) -> str:
        """``Table II.``, ``Table 2 of the report.``, or nothing for a table that neither has."""
        if self.number[0] == "R" and self.number[1:].isdigit():
            return f"Table {self.number[1:]} of the report."
        return f"Table {self.number}." if set(self.number) <= set("IVX") else ""

    def column(self, key: str) -> tuple[Cell, ...]:
        """The cells of one column."""
        place = [column.key for column in self.columns].index(key)
        return tuple(row[place] for row in self.rows)


AP_COLUMNS = {
    f"{view}_{level}": f"ap_{view}/{level}" for view in ("bev", "3d") for level in ("easy", "moderate", "hard")
}
HEADS = {"easy": "Easy", "moderate": "Mod", "hard": "Hard"}
APS = tuple(Column(key, HEADS[key.partition("_")[2]], key.partition("_")[0].upper(), True) for key in AP_COLUMNS)
