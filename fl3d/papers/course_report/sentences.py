"""What the course report says of its own tables: which row is better than which, in which columns. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from fl3d.papers.course_report.published_cells import published_table

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
EASY, MEDIUM, HARD = "3d_easy", "3d_medium", "3d_hard"
LEVELS = (EASY, MEDIUM, HARD)


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


def _batch(size: str) -> Place:
    return "R2", (size,)


def _first(setting: str) -> Place:
    return "R6", ("first", setting)


DEFAULT = _first("Default Parameters")
ALPHA_BEST = ("R3", ("0.80", "0.20"))
SHORT, LONG = ("R4", ("2m", "0.2m")), ("R4", ("3m", "0.5m"))
FINE, COARSE = (("R5", (size, "Box Refinement")) for size in ("0.3 m", "0.5 m"))
REFINED = tuple(("R6", ("refinement", f"{who} Parameters")) for who in ("Our Final", "Default"))
POINTRCNN, FRUSTUM = ("R7", ("PointRCNN",)), ("R7", ("Frustum ConvNet",))
CHOSEN = "no verdict: PointRCNN's setting was chosen on the frames that judge it"


def _of_default(
    text: str,
    printed: str,
    setting: str,
    columns: tuple[str, ...],
    says: Says,
    where: str = "§3.2.2",
) -> Sentence:
    """A first stage of Frustum ConvNet against the default one."""
    return Sentence(
        where=where,
        text=f"Frustum ConvNet: {text}",
        printed=printed,
        row=_first(setting),
        over=(DEFAULT,),
        columns=columns,
        says=says,
    )


OF_POINTRCNN = (
    Sentence(
        where="§3.1.1 i",
        text="PointRCNN: recall of a batch of 32 above 16 and 64",
        printed="at all 5 overlaps",
        row=_batch("32"),
        over=(_batch("16"), _batch("64")),
        columns=RECALLS,
        says=Says.LARGER,
    ),
    Sentence(
        where="§3.1.1 i",
        text="PointRCNN: recall of a batch of 64 as of 16",
        printed="almost similar",
        row=_batch("64"),
        over=(_batch("16"),),
        columns=RECALLS,
        says=Says.ALIKE,
    ),
    Sentence(
        where="§3.1.1 ii",
        text="PointRCNN: recall of α = 0.80 above 0.75 and 0.85",
        printed="the best values",
        row=ALPHA_BEST,
        over=(("R3", ("0.75", "0.25")), ("R3", ("0.85", "0.15"))),
        columns=RECALLS,
        says=Says.LARGER,
    ),
    Sentence(
        where="§3.1.1 iii",
        text="PointRCNN: recall of 2 m in bins of 0.2 m as of 3 m and 0.5 m, overlap up to 0.3",
        printed="same",
        row=SHORT,
        over=(LONG,),
        columns=LOW,
        says=Says.ALIKE,
    ),
    Sentence(
        where="§3.1.1 iii",
        text="PointRCNN: recall of 2 m in bins of 0.2 m above 3 m and 0.5 m, overlap from 0.5",
        printed="higher",
        row=SHORT,
        over=(LONG,),
        columns=HIGH,
        says=Says.LARGER,
    ),
    Sentence(
        where="§3.1.1",
        text="PointRCNN: refined boxes in bins of 0.3 m as of 0.5 m",
        printed="no significant difference",
        row=FINE,
        over=(COARSE,),
        columns=RECALLS,
        says=Says.ALIKE,
    ),
    Sentence(
        where="§3.1.1",
        text="PointRCNN: proposals of the best first stage above the original's (a batch of 16)",
        printed="overall increase",
        row=SHORT,
        over=(_batch("16"),),
        columns=RECALLS,
        says=Says.LARGER,
    ),
    Sentence(
        where="§3.1.1",
        text="PointRCNN: refined boxes no more than 3 % (0.035) below its authors' weights (ours: their loss)",
        printed="2 to 3 percent",
        row=FINE,
        over=(("R1", ("Box Refinement",)),),
        columns=RECALLS,
        says=Says.LARGER,
        than=-0.035,
    ),
)
OF_FRUSTUM = (
    Sentence(
        where="§3.2.2 ii, Fig. 5",
        text="Frustum ConvNet: slabs of 1 m alone above those of 0.5 m alone",
        printed="better performance",
        row=("R_figure_5", ("1",)),
        over=(("R_figure_5", ("0.5",)),),
        columns=LEVELS,
        says=Says.LARGER,
    ),
    _of_default(
        "a batch of 64", "a small drop", "Batch Size = 64", LEVELS, Says.SMALLER, "§3.2.2 i"
    ),
    _of_default("a batch of 8", "a huge drop", "Batch Size = 8", LEVELS, Says.SMALLER, "§3.2.2 i"),
    Sentence(
        where="§3.2.2 ii",
        text="Frustum ConvNet: the default above both sets of larger slabs by more than 3 AP",
        printed="3+ AP",
        row=DEFAULT,
        over=(_first("s and u_half = 1,2,4,8"), _first("s and u_half = 0.5,1,2,4")),
        columns=LEVELS,
        says=Says.LARGER,
        than=3.0,
    ),
    _of_default("α = 0.2, medium", "+0.1", "Alpha = 0.2", (MEDIUM,), Says.LARGER, "§3.2.2 iii"),
    _of_default(
        "α = 0.2, easy and hard",
        "marginal decrease",
        "Alpha = 0.2",
        (EASY, HARD),
        Says.SMALLER,
        "§3.2.2 iii",
    ),
    _of_default(
        "α = 0.3, medium and hard", "+1 %", "Alpha = 0.3", (MEDIUM, HARD), Says.LARGER, "§3.2.2 iii"
    ),
    _of_default(
        "heading weight 30, easy and medium",
        "slight decrease",
        "Head_REG Weight = 30",
        (EASY, MEDIUM),
        Says.SMALLER,
        "§3.2.2 iv",
    ),
    _of_default(
        "heading weight 30, hard",
        "slight increase",
        "Head_REG Weight = 30",
        (HARD,),
        Says.LARGER,
        "§3.2.2 iv",
    ),
    _of_default(
        "heading class times 1.5",
        "marginal decrease",
        "Heading_class loss multiplier = 1.5",
        LEVELS,
        Says.SMALLER,
        "§3.2.2 iv",
    ),
    Sentence(
        where="abstract, §3.2.2",
        text="Frustum ConvNet: final parameters above the default after refinement, medium and hard",
        printed="+6 AP hard",
        row=REFINED[0],
        over=(REFINED[1],),
        columns=(MEDIUM, HARD),
        says=Says.LARGER,
    ),
    Sentence(
        where="abstract, §3.3",
        text="Frustum ConvNet above PointRCNN, easy",
        printed="by a good margin",
        row=FRUSTUM,
        over=(POINTRCNN,),
        columns=(EASY,),
        says=Says.LARGER,
        chosen=CHOSEN,
    ),
    Sentence(
        where="abstract, §3.3",
        text="PointRCNN above Frustum ConvNet, medium and hard",
        printed="better",
        row=POINTRCNN,
        over=(FRUSTUM,),
        columns=(MEDIUM, HARD),
        says=Says.LARGER,
        chosen=CHOSEN,
    ),
)
