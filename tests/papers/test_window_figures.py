"""Figures 4 and 5, the arXiv version's Figure 1, the imbalance by height: what is drawn is what the data beside say."""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.papers.focal_loss.window_figures import (
    BOXES,
    HITS,
    KINDS,
    WINDOWS,
    cumulative_loss,
    figure_4,
    figure_5,
    focal_curves,
    imbalance_by_height,
)
from tests.reports.frames import is_figure

DETECTORS = ("3D-FCN", "VoxelNet")


def test_cumulative_loss_by_hand() -> None:
    """Two positives of p = 1/2 and 1/4: BCE log 2 and 2 log 2; with gamma = 1 times 1/2 and 3/4."""
    logits = np.log([1.0, 1 / 3])
    half = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(cumulative_loss(logits, 1, 0.0, half), [0, 1 / 3, 1])
    np.testing.assert_allclose(cumulative_loss(logits, 1, 1.0, half), [0, 0.5 / (0.5 + 1.5), 1])
    np.testing.assert_allclose(cumulative_loss(-logits, -1, 0.0, half), [0, 1 / 3, 1])


def test_the_focal_loss_over_the_posterior(tmp_path: Path) -> None:
    """At p_t = 1/2: log 2 under BCE, a quarter of it under gamma = 2; at 1 nothing."""
    assert is_figure(focal_curves([0.0, 2.0]).write(tmp_path / "figure_1_arxiv"))
    data = pd.read_csv(tmp_path / "figure_1_arxiv.csv").set_index(["gamma", "p_t"])["loss"]
    assert data[0, 0.5] == pytest.approx(np.log(2), rel=1e-5)
    assert data[2, 0.5] == pytest.approx(np.log(2) / 4, rel=1e-5)
    assert data[0, 1.0] == data[2, 1.0] == 0


def test_the_larger_gamma_the_more_of_the_loss_lies_on_hard_windows(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sampled = {detector: (rng.normal(1, 2, 500), rng.normal(-4, 2, 5000)) for detector in DETECTORS}
    figure = figure_4(sampled, [0.0, 1.0, 5.0])
    assert figure is not None
    assert is_figure(figure.write(tmp_path / "figure_4"))
    data = pd.read_csv(tmp_path / "figure_4.csv")
    assert set(data["windows"]) == {"positives", "negatives"}
    near = data["share"][(data["share"] - 0.999).abs().idxmin()]
    middle = data[data["share"] == near].groupby(["detector", "windows"])["loss"]
    assert all((np.diff(losses) < 0).all() for _, losses in middle)


def test_without_a_focal_model_there_is_no_figure_4() -> None:
    assert figure_4({}, [0.0]) is None


def test_densities_have_unit_area(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    places = itertools.product(DETECTORS, KINDS, (0.0, 5.0))
    posteriors = {place: rng.random(1000) for place in places}
    assert is_figure(figure_5(posteriors).write(tmp_path / "figure_5"))
    data = pd.read_csv(tmp_path / "figure_5.csv")
    areas = data.groupby(["detector", "positives", "gamma"])["density"].mean()
    assert areas.to_list() == pytest.approx([1.0] * 12)


def test_each_kind_of_positives_has_its_own_histogram_and_the_papers_come_first(
    tmp_path: Path,
) -> None:
    """Of four boxes three are below 0.04, and one is on a car; density is share over the width of a bin, 1 / 25."""
    p = {BOXES: [0.01, 0.02, 0.03, 0.99], HITS: [0.99], WINDOWS: [0.01, 0.99]}
    pooled = {("VoxelNet", kind, 0.0): np.array(own) for kind, own in p.items()}
    figure_5(pooled).write(tmp_path / "figure_5")
    data = pd.read_csv(tmp_path / "figure_5.csv")
    assert data["positives"].drop_duplicates().to_list() == [BOXES, HITS, WINDOWS]
    ends = data.groupby("positives", sort=False)["density"].agg(["first", "last"])
    assert ends.to_numpy().tolist() == [[18.75, 6.25], [0.0, 25.0], [12.5, 12.5]]
    assert data["count"].drop_duplicates().to_list() == [4, 1, 2]


def test_a_height_without_positives_has_no_ratio(tmp_path: Path) -> None:
    low = np.array([-2.5, -1.7, -0.9])
    data = pd.DataFrame(
        {"z_low": low, "z_high": low + 0.8, "positives": [0.0, 3.0, 1.0], "negatives": 10_000.0}
    )
    assert is_figure(imbalance_by_height(data).write(tmp_path / "height"))
