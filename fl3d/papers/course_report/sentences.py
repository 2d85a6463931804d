"""What the course report says of its own tables: which row is better than which, in which columns. Pure.

The sentences lie beside the published cells, ``published/sentences.csv``: a row as ``R4 | 2m | 0.2m``, rows that it is
held against parted by semicolons.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

from fl3d.papers.course_report.published_cells import published_sentences, published_table

Place = tuple[str, tuple[str, ...]]  # a table, and the texts that tell a row in it

FRONTS = {
    "R1": ("network",),
    "R2": ("batch_size",),
    "R3": ("alpha_fg", "alpha_bg"),
    "R4": ("search_range", "bin_size"),
    "R5": ("rcnn_bin_size", "network"),
    "R6": ("stage", "setting"),
    "R7": ("method",),
    "R_figure_5": ("strides",),
}
LOW = ("iou_0.1", "iou_0.3")
HIGH = ("iou_0.5", "iou_0.7", "iou_0.9")
RECALLS = (*LOW, *HIGH)
LEVELS = ("3d_easy", "3d_medium", "3d_hard")
COLUMNS = {"recalls": RECALLS, "low": LOW, "high": HIGH, "levels": LEVELS}


class Says(StrEnum):
    """How one row is said to stand to others."""

    LARGER = "larger"
    SMALLER = "smaller"
    ALIKE = "alike"

    def holds(self, difference: float, than: float) -> bool:
        """Of one difference; what is alike has no printed bound."""
        return difference > than if self is Says.LARGER else difference < than


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """A sentence about rows of the report's tables.

    Args:
        where: section.
        text: in our words.
        printed: as the report prints it.
        row: that it is about.
        over: rows that it is held against, each in each column.
        columns: of recall or of 3D AP.
        says: how it stands to them.
        than: what a difference is larger or smaller than.
        chosen: why ours are not judged; empty: they are.
    """

    where: str
    text: str
    printed: str
    row: Place
    over: tuple[Place, ...]
    columns: tuple[str, ...]
    says: Says
    than: float = 0.0
    chosen: str = ""

    @property
    def is_recall(self) -> bool:
        """Whether it is of recalls, in 0 to 1, and not of AP in percent."""
        return self.columns[0] in RECALLS


def printed_cell(place: Place, column: str) -> float:
    """A number that the report prints."""
    number, front = place
    rows = published_table(number).to_dict("records")
    row = next(one for one in rows if tuple(one[key] for key in FRONTS[number]) == front)
    return float(row[f"{column.removeprefix('3d_')}_3d" if number == "R7" else column])


DEFAULT: Place = ("R6", ("first", "Default Parameters"))


@cache
def sentences(told_with: str) -> tuple[Sentence, ...]:
    """The sentences that are told with a detector, ``PointRCNN`` or ``Frustum ConvNet``, in the report's order."""
    rows = published_sentences().to_dict("records")
    return tuple(_sentence(row) for row in rows if row["told_with"] == told_with)


def _sentence(row: Mapping[Hashable, str]) -> Sentence:
    return Sentence(
        where=row["where"],
        text=row["text"],
        printed=row["printed"],
        row=_place(row["row"]),
        over=tuple(_place(text) for text in row["over"].split(" ; ")),
        columns=COLUMNS.get(row["columns"]) or tuple(row["columns"].split()),
        says=Says(row["says"]),
        than=float(row["than"]),
        chosen=row["chosen"],
    )


def _place(text: str) -> Place:
    """``R4 | 2m | 0.2m`` -> ``("R4", ("2m", "0.2m"))``."""
    number, *front = text.split(" | ")
    return number, tuple(front)
