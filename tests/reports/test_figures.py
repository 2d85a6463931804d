"""Curves of any sweep: what is drawn is what the data beside say."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from fl3d.reports.figures import curves
from fl3d.reports.figures.curves import (
    ap_over_cut,
    ap_over_level,
    ap_over_steps,
    best_of_k_figure,
    precision_recall,
)
from fl3d.reports.figures.style import STYLE, save, shades, write_data
from fl3d.reports.levels import Levels
from tests.reports.frames import GROUPS, is_figure, tidy_scores

GAMMAS = Levels("gamma", ["0", "2"], "0")
TEXTS = Levels("loss", ["original", "enhanced"], "original")
SEVERAL = Levels(
    "alpha, gamma", ["alpha=0.25, gamma=2", "alpha=0.75, gamma=2"], "alpha=0.25, gamma=2"
)
EVERY = pytest.mark.parametrize("levels", [GAMMAS, TEXTS, SEVERAL], ids=lambda levels: levels.name)


def levels_in(path: Path) -> list[str]:
    """Levels of a figure's data, in their order."""
    data = pd.read_csv(path, dtype={"level": str})
    return list(dict.fromkeys(data["level"]))


@EVERY
def test_last_and_best_are_marked(levels: Levels, tmp_path: Path) -> None:
    scores = tidy_scores(levels.labels)
    last = scores[scores["step"] == 30]
    best = scores[scores["step"] == 20]
    assert is_figure(ap_over_steps(scores, last, best, levels).write(tmp_path / "steps"))
    data = pd.read_csv(tmp_path / "steps.csv")
    assert set(data[data["last"]]["step"]) == {30}
    assert set(data[data["best"]]["step"]) == {20}
    assert levels_in(tmp_path / "steps.csv") == levels.labels


def bands(axes: Axes) -> list[tuple[float, float]]:
    """Lowest and highest AP of each band that was drawn."""
    found = []
    for band in axes.collections:
        heights = band.get_paths()[0].vertices[:, 1]
        found.append((heights.min(), heights.max()))
    return found


@pytest.mark.parametrize("seeds", [(0,), (0, 1, 2)])
def test_a_band_reaches_from_the_lowest_to_the_highest_seed(
    seeds: tuple[int, ...],
) -> None:
    scores = tidy_scores(["0"], ["VoxelNet"], seeds)
    scores["ap_3d/moderate"] += scores["seed"] * 4.0
    last = scores[scores["step"] == 30]
    (axes,) = ap_over_steps(scores, last, last, GAMMAS).figure.axes
    line = axes.lines[0]
    assert list(line.get_ydata()) == [ap + 4.0 * (len(seeds) > 1) for ap in (10.0, 20.0, 15.0)]
    assert bands(axes) == ([] if len(seeds) == 1 else [(10.0, 28.0)])


def test_a_curve_is_of_the_same_seeds_at_all_of_its_steps() -> None:
    """Seed 1, which is 4 higher, has no checkpoint at step 20: without it the curve would be 20 there."""
    scores = tidy_scores(["0"], ["VoxelNet"], (0, 1))
    scores["ap_3d/moderate"] += scores["seed"] * 4.0
    scores = scores[(scores["seed"] == 0) | (scores["step"] != 20)]
    last = scores[scores["step"] == 30]
    (axes,) = ap_over_steps(scores, last, last, GAMMAS).figure.axes
    assert axes.lines[0].get_xydata().tolist() == [[10, 12], [30, 17]]
    assert bands(axes) == [(10.0, 19.0)]


def test_each_levels_last_stage_begins_where_it_does() -> None:
    """One line where all begin at step 5; else one of each level in its colour."""
    scores = tidy_scores(["0", "2"], ["VoxelNet"], (0, 1))
    last = scores[scores["step"] == 30]

    def forks() -> list[tuple[float, str]]:
        (axes,) = ap_over_steps(scores, last, last, GAMMAS).figure.axes
        own = [line for line in axes.lines if line.get_linestyle() == ":"]
        return [(line.get_xdata()[0], str(line.get_color())) for line in own]

    assert forks() == [(5, "0.6")]
    scores.loc[scores["level"] == "2", "first_own_step"] = 15
    colors = [str(color) for _, (color, _) in shades(GAMMAS.labels)]
    assert forks() == [(5, colors[0]), (15, colors[1])]


def test_long_bars_leave_the_panel_and_curves_stay_legible() -> None:
    figure, axes = plt.subplots()
    axes.plot([0, 0], [-30, 160])
    curves._keep_in_sight(axes, np.array([60.0, 70.0]))
    assert axes.get_ylim() == (55.0, 75.0)
    plt.close(figure)


def test_a_bar_reaches_from_end_to_end_where_the_value_is_not_in_the_middle() -> None:
    ends = {"ap_3d/moderate": [53.0], "ap_3d/moderate low": [52.0], "ap_3d/moderate high": [58.0]}
    figure, axes = plt.subplots()
    curves._bars(axes, np.array([0.0]), pd.DataFrame(ends), "black")
    (bar,) = axes.collections
    assert bar.get_segments()[0].tolist() == [[0, 52], [0, 58]]
    plt.close(figure)


@EVERY
def test_intervals_become_bars(levels: Levels, tmp_path: Path) -> None:
    scores = tidy_scores(levels.labels, seeds=(0, 1))
    row = {
        "metric": "3d",
        "difficulty": "moderate",
        "average": "R11",
        "ap": 16.0,
        "ap_low": 1.0,
        "ap_high": 99.0,
    }
    gains = pd.DataFrame(
        [{"group": group, "level": level, **row} for group in GROUPS for level in levels.labels]
    )
    assert is_figure(
        ap_over_level(scores[scores["step"] == 30], levels, gains).write(tmp_path / "level")
    )
    data = pd.read_csv(tmp_path / "level.csv")
    assert len(data) == len(GROUPS) * 2
    assert set(data["ap_3d/moderate high"]) == {99.0}
    assert set(data["ap_3d/moderate"]) == {16.0}  # of the seeds that the bars are of
    assert set(data["ap_3d/easy"]) == {15.0, 17.0}
    assert levels_in(tmp_path / "level.csv") == levels.labels


def test_a_level_without_gains_keeps_the_mean_of_its_own_seeds_and_has_no_bar() -> None:
    """Of gamma 2, 15 less than step 30 and 2 for its place, there is no gain."""
    scores = tidy_scores(GAMMAS.labels, ["VoxelNet"], (0, 1))
    row = {"group": "VoxelNet", "level": "0", "metric": "3d", "difficulty": "moderate"}
    gains = pd.DataFrame([row | {"average": "R11", "ap": 16.0, "ap_low": 1.0, "ap_high": 99.0}])
    data = ap_over_level(scores[scores["step"] == 30], GAMMAS, gains).data
    assert data is not None
    assert data["ap_3d/moderate"].tolist() == [16, 17]
    assert data["ap_3d/moderate low"].isna().tolist() == [False, True]


def test_without_the_baseline_there_are_no_thin_lines_and_no_error(tmp_path: Path) -> None:
    scores = tidy_scores(["2"])
    assert is_figure(ap_over_level(scores[scores["step"] == 30], GAMMAS).write(tmp_path / "level"))


def test_levels_are_drawn_by_their_order_and_not_by_the_alphabet(tmp_path: Path) -> None:
    levels = Levels("gamma", ["0.5", "2", "10"], "0.5")
    scores = tidy_scores(["10", "2", "0.5"])
    ap_over_level(scores[scores["step"] == 30], levels).write(tmp_path / "level")
    assert levels_in(tmp_path / "level.csv") == levels.labels


@EVERY
def test_seeds_are_averaged_over_cuts(levels: Levels, tmp_path: Path) -> None:
    rows = [
        {"group": group, "level": level, "score_threshold": cut, "ap_3d/moderate": ap}
        for group in GROUPS
        for level in levels.labels
        for cut in ("0", "0.5")
        for ap in (10.0, 20.0)
    ]
    assert is_figure(ap_over_cut(pd.DataFrame(rows), levels).write(tmp_path / "cut"))
    data = pd.read_csv(tmp_path / "cut.csv")
    assert set(data["ap_3d/moderate"]) == {15.0}
    assert set(data["cut"]) == {0.0, 0.5}
    assert set(levels_in(tmp_path / "cut.csv")) == set(levels.labels)


@EVERY
def test_precision_is_drawn_for_each_group(levels: Levels, tmp_path: Path) -> None:
    curve = {"recall": np.linspace(0, 1, 41), "precision": np.linspace(1, 0, 41)}
    parts = [
        pd.DataFrame({"group": group, "level": level, **curve})
        for group in GROUPS
        for level in levels.labels
    ]
    assert is_figure(precision_recall(pd.concat(parts), levels).write(tmp_path / "pr"))
    assert levels_in(tmp_path / "pr.csv") == levels.labels


@EVERY
def test_what_looking_k_times_is_worth_is_drawn(levels: Levels, tmp_path: Path) -> None:
    rows = [
        {"group": "VoxelNet", "level": level, "k": k, "best": 50.0 + k}
        for level in levels.labels
        for k in (1, 2)
    ]
    assert is_figure(best_of_k_figure(pd.DataFrame(rows), levels).write(tmp_path / "k"))
    assert levels_in(tmp_path / "k.csv") == levels.labels


def test_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    scores = tidy_scores(GAMMAS.labels)
    last = scores[scores["step"] == 30]
    first = ap_over_level(last, GAMMAS).write(tmp_path / "a")
    second = ap_over_level(last, GAMMAS).write(tmp_path / "b")
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_names_with_a_dot_have_figures_of_their_own(tmp_path: Path) -> None:
    written = [
        path.name
        for name in ("ap_trials.1a", "ap_trials.2b")
        for path in [write_data(pd.DataFrame({"ap": [1.0]}), tmp_path / name)]
    ]
    figure, _ = plt.subplots()
    written += [path.name for path in save(figure, tmp_path / "ap_trials.1a")]
    assert written == [
        "ap_trials.1a.csv",
        "ap_trials.2b.csv",
        "ap_trials.1a.png",
        "ap_trials.1a.pdf",
    ]


def test_a_dollar_in_a_name_is_a_dollar_and_log_axes_keep_their_powers(tmp_path: Path) -> None:
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots()
        axes.semilogy([1, 2], [1, 1000], label="costs $5 or $6")
        title = axes.set_title("a $b$ c_{d}")
        legend = axes.legend().get_texts()[0]
        figure.canvas.draw()
        powers = [tick.label1 for tick in axes.yaxis.get_major_ticks()]
        save(figure, tmp_path / "figure", (".png",))
    assert not title.get_parse_math()
    assert not legend.get_parse_math()
    assert any("10^{2}" in power.get_text() for power in powers)
    assert all(power.get_parse_math() for power in powers)
