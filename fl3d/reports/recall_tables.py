"""Tables 1 to 5 of the course report: recall of PointRCNN's boxes, beside what it printed. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import pandas as pd

from fl3d.reports.published import published_table
from fl3d.reports.selection import select
from fl3d.reports.table import Cell, Column, Table

OVERLAPS = ("0.1", "0.3", "0.5", "0.7", "0.9")
NETWORKS = ("Box Proposal", "Box Refinement")  # last checkpoints of the first and of the second stage
BOLD = "Recall of cars by 3D overlap; bold: best of its column"

Front = tuple[str, ...]


@dataclass(frozen=True)
class _Layout:
    """One table.

    Args:
        caption: of it.
        heads: of its front columns, by their names in the published file.
        front: texts of the front columns from a trial's overrides.
        networks: whether proposals and refined boxes have rows of their own.
    """

    caption: str
    heads: Mapping[str, str]
    front: Callable[[str], Front]
    networks: bool = False


def _value(overrides: str, key: str) -> str:
    """What an override sets, or nothing where it is not among them."""
    found = [part.partition("=")[2] for part in overrides.split(" ") if part.partition("=")[0] == key]
    return found[-1] if found else ""


def _batch(overrides: str) -> Front:
    return (_value(overrides, "schedule.stages.rpn.set.schedule.batch_size"),)


def _alpha(overrides: str) -> Front:
    alpha = float(_value(overrides, "loss.alpha") or "nan")
    return f"{alpha:.2f}", f"{1 - alpha:.2f}"


def _bins(overrides: str) -> Front:
    values = dict(pair.split(":") for pair in _value(overrides, "detector.rpn").strip("{}").split(",") if ":" in pair)
    return tuple(f"{float(values.get(key, 'nan')):g}m" for key in ("search", "bin"))


def _rcnn_bin(overrides: str) -> Front:
    return (f"{_value(overrides, 'detector.rcnn.bin')} m",)


LAYOUTS = {
    "R1": _Layout("Recall of PointRCNN under its authors' loss", {}, lambda overrides: (), networks=True),
    "R2": _Layout("Recall of proposals by batch size", {"batch_size": "Batch Size"}, _batch),
    "R3": _Layout("Recall of proposals by alpha", {"alpha_fg": "α foreground", "alpha_bg": "α background"}, _alpha),
    "R4": _Layout(
        "Recall of proposals by search range and bin", {"search_range": "Search Range", "bin_size": "Bin Size"}, _bins
    ),
    "R5": _Layout("Recall of boxes by the second stage's bin", {"rcnn_bin_size": "Bin Size"}, _rcnn_bin, networks=True),
}


def recall_table(scores: pd.DataFrame, number: str, notes: tuple[str, ...] = ()) -> Table:
    """A table of the report, ours on the left and the printed cells on the right; seeds are averaged.

    Args:
        scores: tidy, with ``overrides`` and recalls.
        number: ``R1`` to ``R5``.
        notes: put below.
    """
    layout = LAYOUTS[number]
    rows = _rows(scores, layout)
    printed = published_table(number)
    fronts = [*layout.heads, *(["network"] if layout.networks else [])]
    theirs = {tuple(row[key] for key in fronts): row for row in printed.to_dict("records")}
    values_by_column = [{float(values[i]) for values in rows.values()} for i in range(len(OVERLAPS))]
    best = [max(values) if len(values) > 1 else None for values in values_by_column]  # where all are equal none is best
    bolds = number != "R1"
    cells = []
    for front, values in rows.items():
        own = [Cell(v, bold=bolds and float(v) == best[i]) for i, v in enumerate(values)]
        known = theirs.get(front)
        keys = [f"iou_{overlap}" for overlap in OVERLAPS]
        other = [Cell(str(known[key]), known[f"{key}_bold"] == "1") if known else Cell("") for key in keys]
        cells.append((*(Cell(text) for text in front), *own, *other))
    heads = {**layout.heads, **({"network": "Network"} if layout.networks else {})}
    columns = (
        *(Column(key, head) for key, head in heads.items()),
        *(Column(f"iou_{overlap}", overlap, "IoU, ours", True) for overlap in OVERLAPS),
        *(Column(f"iou_{overlap}_published", overlap, "IoU, report", True) for overlap in OVERLAPS),
    )
    return Table(number, layout.caption, columns, tuple(cells), BOLD if bolds else BOLD.partition(";")[0], notes)


def _rows(scores: pd.DataFrame, layout: _Layout) -> dict[Front, list[str]]:
    """Printed recalls by front texts, in the scores' order of what they are swept over."""
    last = select(scores, "last")
    stages = [(NETWORKS[1], last)]
    if layout.networks:
        first = scores[scores["step"] <= scores["first_own_step"]]
        stages = [(NETWORKS[0], select(first, "last")), *stages]
    keys = [f"recall_3d/{overlap}" for overlap in OVERLAPS]
    found: dict[Front, list[str]] = {}
    for front in sorted(set(last["overrides"].map(layout.front)), key=_by_number):
        for network, rows in stages:
            own = rows[rows["overrides"].map(layout.front) == front][keys].mean()
            row = (*front, network) if layout.networks else front
            found[row] = [f"{own[key]:.3f}" for key in keys]
    return found


def _by_number(front: Front) -> tuple[float, ...]:
    """Fronts in the printed order: batch, alpha rise; search ranges and bins fall."""
    values = [float(text.rstrip("m ")) for text in front]
    return tuple(-value if text.endswith("m") else value for text, value in zip(front, values, strict=True))
