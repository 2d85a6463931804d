"""A forest plot: what is drawn is what the data beside say, and it fits its panel."""

import math
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from PIL import Image

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.figures.forest import LOOKS, forest
from fl3d.reports.figures.style import Drawn, styled
from fl3d.reports.levels import Levels
from tests.reports.frames import GROUPS, is_figure
from tests.reports.verdict_rows import ENDS, verdict_rows

GAMMAS = Levels("gamma", ["0", "0.1", "0.5", "1", "2", "5"], "0")
LONG = Levels(
    "detector.coding",
    ["search=3 bin=0.5 more=null", *(f"search=2 bin=0.{n} head=enhanced long=yes" for n in "123")],
    "search=3 bin=0.5 more=null",
)
MANY = Levels("alpha, gamma", [f"alpha=0.25, gamma={n}" for n in range(13)], "alpha=0.25, gamma=0")
TWO = Levels("loss", ["original", "enhanced"], "original")


def written(plot: Drawn | None, path: Path) -> list[Path]:
    """The files of a plot, of which there is one."""
    assert plot is not None
    return plot.write(path)


def drawn(rows: pd.DataFrame, levels: Levels, path: Path) -> list[Axes]:
    """The panels of a plot, laid out as they are saved."""
    plot = forest(rows, levels, 1.0)
    written(plot, path)
    assert plot is not None
    with styled():
        plot.figure.draw_without_rendering()
    return [axes for axes in plot.figure.axes if axes.axison]


@pytest.mark.parametrize(
    ("levels", "groups"),
    [
        (GAMMAS, GROUPS),
        (LONG, ["PointRCNN, jitter=true"]),
        (LONG, GROUPS),
        (MANY, [*GROUPS, "PointRCNN"]),
        (TWO, ["VoxelNet"]),
    ],
)
def test_nothing_is_cut_off_or_lies_on_another(
    levels: Levels, groups: Sequence[str], tmp_path: Path
) -> None:
    """Names, numbers and labels lie within the page, and names not on each other."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib warns where a panel has no room
        panels = drawn(verdict_rows(levels, groups), levels, tmp_path / "f")
    assert len(panels) == len(groups)
    for axes in panels:
        page = axes.figure.bbox
        names = [name.get_window_extent() for name in axes.get_yticklabels()]
        boxes = [*names, *(text.get_window_extent() for text in axes.texts)]
        boxes.append(axes.xaxis.label.get_window_extent())
        assert len(names) == len(levels.labels) - 1
        for box in boxes:
            assert box.x0 >= page.x0 - 1
            assert box.x1 <= page.x1 + 1
            assert box.y0 >= page.y0 - 1
        for upper, lower in pairwise(names):
            assert upper.y0 > lower.y1
        for numbers in axes.texts:
            assert numbers.get_window_extent().x1 <= axes.bbox.x1 + 8
        assert axes.bbox.width > page.width / min(2, len(panels)) / 2.2


def test_each_verdict_has_a_marker_of_its_own_so_that_grey_tells_them_apart() -> None:
    assert set(LOOKS) == set(Verdict) - {Verdict.BASELINE}
    assert len({marker for _, marker, _ in LOOKS.values()}) == len(LOOKS)
    finals = {LOOKS[verdict][2] for verdict in Verdict if verdict.is_final}
    assert finals == {True}
    assert {look[2] for verdict, look in LOOKS.items() if not verdict.is_final} == {False}


def test_lines_markers_and_numbers_are_those_of_the_rows(
    tmp_path: Path,
) -> None:
    rows = verdict_rows(GAMMAS, ("VoxelNet",)).iloc[::-1]
    (axes,) = drawn(rows, GAMMAS, tmp_path / "forest")
    names = [name.get_text() for name in axes.get_yticklabels()]
    assert names == [f"γ = {level}" for level in GAMMAS.labels[1:]]
    by_level = rows.set_index("level")
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_lw() > 1]
    spots = [line for line in axes.lines if len(line.get_xdata()) == 1]
    for place, level in enumerate(GAMMAS.labels[1:]):
        row = by_level.loc[level]
        assert list(lines[place].get_xdata()) == [row["gain_low"], row["gain_high"]]
        assert set(lines[place].get_ydata()) == {place}
        assert list(spots[place].get_xdata()) == [row["gain"]]
        assert spots[place].get_marker() == LOOKS[Verdict(row["verdict"])][1]
        text = f"{row['gain']:+.1f} [{row['gain_low']:+.1f}, {row['gain_high']:+.1f}]  n = 5"
        assert axes.texts[place].get_text() == text


def test_zero_and_the_margin_are_in_the_picture_however_far_the_gains_are(
    tmp_path: Path,
) -> None:
    rows = verdict_rows(TWO, ("VoxelNet",), ends={**ENDS, Verdict.BETTER: (30.0, 33.0, 36.0)})
    (axes,) = drawn(rows, TWO, tmp_path / "far")
    assert axes.get_xlim()[0] == -axes.get_xlim()[1]
    assert axes.get_xlim()[1] > 36
    small = verdict_rows(TWO, ("VoxelNet",), ends={**ENDS, Verdict.BETTER: (0.01, 0.02, 0.03)})
    (axes,) = drawn(small, TWO, tmp_path / "near")
    assert axes.get_xlim()[1] > 1.0


def test_it_is_written_with_its_data_and_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    rows = verdict_rows(GAMMAS)
    first = written(forest(rows, GAMMAS, 1.0), tmp_path / "a")
    second = written(forest(rows, GAMMAS, 1.0), tmp_path / "b")
    assert is_figure(first)
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
    data = pd.read_csv(tmp_path / "a.csv", dtype={"level": str})
    assert data["verdict"].tolist() == rows["verdict"].tolist()
    assert data["gain_low"].tolist() == rows["gain_low"].tolist()


def test_a_sweep_of_the_baseline_alone_has_no_plot(tmp_path: Path) -> None:
    rows = verdict_rows(GAMMAS)
    assert forest(rows[rows["level"] == "0"], GAMMAS, 1.0) is None
    assert list(tmp_path.iterdir()) == []


def test_the_margin_is_seen_in_grey(tmp_path: Path) -> None:
    written(forest(verdict_rows(TWO, ("VoxelNet",)), TWO, 1.0), tmp_path / "grey")
    grey = np.asarray(Image.open(tmp_path / "grey.png").convert("L"))
    assert ((grey > 225) & (grey < 245)).mean() > 0.02
    assert math.isclose(float(np.median(grey)), 255)
