"""What an evaluation of a folder says first: its rules and its table. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from fl3d.evaluation.average_precision import Curve, Curves, average_r11, average_r40
from fl3d.evaluation.folders import Evaluated
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol


def heading(found: Evaluated) -> str:
    """One line: frames, and the rules that the numbers stand for."""
    protocol = found.protocol
    rules = f"protocol {protocol.name}"
    if protocol.uses_picture:
        rules += f" (variant {protocol.variant})"
    else:
        graded = "" if protocol.level_limits is None else "easy, moderate, hard: "
        rules += f" (fl3d's own, without the picture; {graded}{protocol.levels_text})"
    return f"{len(found.frames.ids)} frames, {rules}; AP in percent"


def shown_levels(protocol: Protocol) -> dict[str, str]:
    """Levels that a table shows, and what they are called: where all three are the same, one."""
    if protocol.difficulty == "none":
        return {DIFFICULTIES[0]: "all"}
    return {level: level for level in DIFFICULTIES}


def curves_to_markdown(curves: Curves, protocol: Protocol) -> str:
    """R11, R40 and the number of ground truths of every class and metric that has one, as Markdown.

    Columns are filled up with blanks, so that it can be read as it is; 120 wide at most on KITTI's validation split.
    """
    levels = shown_levels(protocol)
    head = ["class", "metric"]
    head += [f"{average} {name}" for average in ("R11", "R40") for name in levels.values()]
    rows = []
    for name, metrics in curves.items():
        for metric, by_level in metrics.items():
            own = [by_level[level] for level in levels]
            if any(curve.n_gt for curve in own):
                rows.append([name, metric, *_aps(own), "/".join(str(curve.n_gt) for curve in own)])
                rows += [[name, "orientation", *_similar(own), rows[-1][-1]]] * _has_angle(own)
    return _aligned([*head, "n_gt"], rows)


def _aps(own: Sequence[Curve]) -> list[str]:
    return [
        f"{ap:.4f}" if curve.n_gt else "-"
        for aps in ([curve.ap_r11 for curve in own], [curve.ap_r40 for curve in own])
        for ap, curve in zip(aps, own, strict=True)
    ]


def _has_angle(own: Sequence[Curve]) -> bool:
    return all(curve.orientation is not None for curve in own)


def _similar(own: Sequence[Curve]) -> list[str]:
    return [
        f"{average(curve.orientation):.4f}" if curve.n_gt and curve.orientation is not None else "-"
        for average in (average_r11, average_r40)
        for curve in own
    ]


def _aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first two columns are text, the others numbers."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.ljust(width) if place < 2 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return "| " + " | ".join(padded) + " |"

    rule = "|" + "|".join(
        "-" * (width + 2) if place < 2 else "-" * (width + 1) + ":"
        for place, width in enumerate(widths)
    )
    return "\n".join([line(head), rule + "|", *map(line, rows)])
