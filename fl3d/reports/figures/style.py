"""How all figures look: legible in one column of a page, and in grey; fonts embedded; no dates in the files.

Nothing here uses pyplot, whose state is the caller's: importing fl3d leaves a notebook's backend and styles alone.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from fl3d.core.files import write_atomically, write_text
from fl3d.reports.levels import Levels

STYLE: Any = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
PURPLE, BLUE, ORANGE = (
    "#7b2d8b",
    "#1f5fbf",
    "#d07a1c",
)  # ground truth and estimates as in the paper's Figure 1
MARKERS = "osD^v<>PX*"
METADATA = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
ENDINGS = (".png", ".pdf")  # that a figure is written with
COLUMN = 3.5  # inches: one column of a two-column page
LEGEND_LETTERS = 17  # of a legend's 7 point font on an inch, measured on its widest labels
SHOWN_DPI = 100  # in a notebook
LEGEND_HANDLE = 6  # letters that a legend's line and the gap behind it take


class Drawing(Figure):
    """A figure that a notebook shows where it is a cell's value, whatever backend is chosen."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        with styled():
            self.savefig(content, format="png", dpi=SHOWN_DPI)
        return content.getvalue()


@dataclass(frozen=True)
class Drawn:
    """A figure, and the data that it shows.

    Args:
        figure: in fl3d's style.
        data: a row a mark, or a point of a curve; None of a picture.
    """

    figure: Figure
    data: pd.DataFrame | None = None

    def write(self, path: Path, endings: tuple[str, ...] = ENDINGS) -> list[Path]:
        """Write both; every file written.

        Args:
            path: without ending.
            endings: of the figure.
        """
        data = [] if self.data is None else [write_data(self.data, path)]
        return [*data, *save(self.figure, path, endings)]


def settings() -> dict[str, str]:
    """How matplotlib is set up, by the user too, as text."""
    return {str(key): repr(value) for key, value in matplotlib.rcParams.items()}


def styled() -> AbstractContextManager[None]:
    """Within it, everything is drawn and written in fl3d's style."""
    return matplotlib.rc_context(STYLE)


def canvas(
    rows: int, columns: int, size: tuple[float, float], height_ratios: Sequence[float] | None = None
) -> tuple[Figure, NDArray[Any]]:
    """A figure and its axes (rows, columns), to be drawn on while ``styled``.

    Args:
        rows: of axes.
        columns: likewise.
        size: width and height in inches.
        height_ratios: of the rows; None: all alike.
    """
    figure = Drawing(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, height_ratios=height_ratios)


def save(figure: Figure, path: Path, endings: tuple[str, ...] = ENDINGS) -> list[Path]:
    """Write a figure without dates, so that the same data give the same bytes."""
    _take_dollars_as_dollars(figure)
    written = []
    for ending in endings:
        values = METADATA[ending]
        target = beside(path, ending)

        def draw(temporary: Path, kind: str = ending[1:], values: dict[str, None] = values) -> None:
            with styled():  # fonts are embedded as the style says
                figure.savefig(temporary, format=kind, metadata=values, dpi=200)

        write_atomically(target, draw)
        written.append(target)
    return written


def _take_dollars_as_dollars(figure: Figure) -> None:
    """A name may hold dollar signs; what matplotlib itself writes between two, on log axes, stays a formula."""
    for text in figure.findobj(Text):
        if isinstance(text, Text) and "$" in text.get_text():
            text.set_parse_math("mathdefault" in text.get_text())


def beside(path: Path, ending: str) -> Path:
    """A file of a figure; what follows a dot in a sweep's name is no ending that another takes the place of."""
    return path.with_name(f"{path.name}{ending}")


def write_data(frame: pd.DataFrame, path: Path) -> Path:
    """The data of a figure, beside it."""
    target = beside(path, ".csv")
    write_text(target, frame.to_csv(index=False, lineterminator="\n", float_format="%.6g"))
    return target


def shades(levels: Sequence[str]) -> list[tuple[str, tuple[Any, str]]]:
    """A colour and a marker for each level: dark to light, so that they differ in grey too."""
    colors = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(levels)))
    looks = [(color, MARKERS[number % len(MARKERS)]) for number, color in enumerate(colors)]
    return list(zip(levels, looks, strict=True))


def draw_by_level(
    axes: Axes, own: pd.DataFrame, levels: Levels, x: str, y: str, every: float = 1
) -> None:
    """A curve for each level: column ``y`` against ``x``, a marker at every so many points (or share of the curve)."""
    for level, (color, marker) in shades(levels.labels):
        curve = own[own["level"] == level]
        if curve.empty:
            continue
        look = {"color": color, "marker": marker, "ms": 2.5, "markevery": every, "lw": 1}
        axes.plot(curve[x], curve[y], label=levels.text(level), **look)


def _columns_that_fit(labels: Sequence[str], width: float) -> int:
    """Columns of a legend on a figure so many inches wide."""
    longest = max(len(label) for label in labels) + LEGEND_HANDLE
    return max(1, int(width * LEGEND_LETTERS / longest))


def panels(
    names: Sequence[str],
    panel: Callable[[Axes, str], None],
    legend_columns: int,
    height: float = 2.9,
) -> Figure:
    """Panels in rows of two, as wide as a page's two columns, with one legend below."""
    n_rows, n_columns = -(-len(names) // 2), min(2, len(names))
    with styled():
        figure, grid = canvas(n_rows, n_columns, (COLUMN * n_columns, height * n_rows))
        for spare in grid.flat[len(names) :]:
            spare.set_axis_off()
        for axes, name in zip(grid.flat, names, strict=False):
            panel(axes, name)
            axes.set_title(name)
        shown: dict[str, Any] = {}
        for axes in grid.flat:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                shown.setdefault(label, handle)
        labels = list(shown)
        if labels:
            columns = min(legend_columns, _columns_that_fit(labels, COLUMN * n_columns))
            look: Any = {"fontsize": 7, "frameon": False, "loc": "outside lower center"}
            figure.legend(list(shown.values()), labels, ncols=columns, **look)
    _take_dollars_as_dollars(figure)
    return figure
