"""Figures: what is drawn is what the data beside say; by hand where that can be."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.reports.figures.curves import ap_over_cut, ap_over_gamma, ap_over_steps, precision_recall
from fl3d.reports.figures.windows import cumulative_loss, figure_4, figure_5, imbalance_by_height
from fl3d.reports.table import AP_COLUMNS

DETECTORS = ("3D-FCN", "VoxelNet")


def tidy_scores() -> pd.DataFrame:
    rows = []
    for detector in DETECTORS:
        for gamma in (0.0, 2.0):
            for step in (10, 20, 30):
                plain = {"trial": f"{detector}{gamma}", "detector": detector, "gamma": gamma, "seed": 0, "step": step}
                aps = {metric: step + gamma - (step == 30) * 15 for metric in AP_COLUMNS.values()}
                rows.append(plain | {"first_own_step": 5} | aps)
    return pd.DataFrame(rows)


def is_figure(written: list[Path]) -> bool:
    return {path.suffix for path in written} == {".csv", ".png", ".pdf"} and all(
        path.stat().st_size for path in written
    )


def test_last_and_best_are_marked(tmp_path: Path) -> None:
    assert is_figure(ap_over_steps(tidy_scores(), tmp_path / "steps"))
    data = pd.read_csv(tmp_path / "steps.csv")
    assert set(data[data["last"]]["step"]) == {30}
    assert set(data[data["best"]]["step"]) == {20}


def test_intervals_become_bars(tmp_path: Path) -> None:
    row = {"metric": "3d", "difficulty": "moderate", "average": "R11", "ap_low": 1.0, "ap_high": 99.0}
    gains = pd.DataFrame([{"detector": d, "gamma": g, **row} for d in DETECTORS for g in (0.0, 2.0)])
    assert is_figure(ap_over_gamma(tidy_scores(), tmp_path / "gamma", gains))
    data = pd.read_csv(tmp_path / "gamma.csv")
    assert set(data["ap_3d/moderate high"]) == {99.0}
    assert set(data["ap_3d/moderate"]) == {15.0, 17.0}


def test_seeds_are_averaged_over_cuts(tmp_path: Path) -> None:
    rows = [
        {"detector": d, "gamma": 0.0, "score_threshold": cut, "ap_3d/moderate": ap}
        for d in DETECTORS
        for cut in ("0", "0.5")
        for ap in (10.0, 20.0)
    ]
    assert is_figure(ap_over_cut(pd.DataFrame(rows), tmp_path / "cut"))
    assert set(pd.read_csv(tmp_path / "cut.csv")["ap_3d/moderate"]) == {15.0}


def test_precision_is_drawn_for_each_detector(tmp_path: Path) -> None:
    curve = {"recall": np.linspace(0, 1, 41), "precision": np.linspace(1, 0, 41)}
    curves = pd.concat([pd.DataFrame({"detector": d, "gamma": 0.0, **curve}) for d in DETECTORS])
    assert is_figure(precision_recall(curves, tmp_path / "pr"))


def test_cumulative_loss_by_hand() -> None:
    """Two positives of p = 1/2 and 1/4: BCE log 2 and 2 log 2; with gamma = 1 times 1/2 and 3/4."""
    logits = np.log([1.0, 1 / 3])
    half = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(cumulative_loss(logits, 1, 0.0, half), [0, 1 / 3, 1])
    np.testing.assert_allclose(cumulative_loss(logits, 1, 1.0, half), [0, 0.5 / (0.5 + 1.5), 1])
    np.testing.assert_allclose(cumulative_loss(-logits, -1, 0.0, half), [0, 1 / 3, 1])


def test_the_larger_gamma_the_more_of_the_loss_lies_on_hard_windows(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sampled = {d: (rng.normal(1, 2, 500), rng.normal(-4, 2, 5000)) for d in DETECTORS}
    assert is_figure(figure_4(sampled, [0.0, 1.0, 5.0], tmp_path / "figure_4"))
    data = pd.read_csv(tmp_path / "figure_4.csv")
    assert set(data["windows"]) == {"positives", "negatives"}
    near = data["share"][(data["share"] - 0.999).abs().idxmin()]
    middle = data[data["share"] == near].groupby(["detector", "windows"])["loss"]
    assert all((np.diff(losses) < 0).all() for _, losses in middle)


def test_densities_have_unit_area(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    posteriors = {(d, g): rng.random(1000) for d in DETECTORS for g in (0.0, 5.0)}
    assert is_figure(figure_5(posteriors, tmp_path / "figure_5"))
    data = pd.read_csv(tmp_path / "figure_5.csv")
    assert data.groupby(["detector", "gamma"])["density"].mean().to_list() == pytest.approx([1.0] * 4)


def test_a_height_without_positives_has_no_ratio(tmp_path: Path) -> None:
    low = np.array([-2.5, -1.7, -0.9])
    data = pd.DataFrame({"z_low": low, "z_high": low + 0.8, "positives": [0.0, 3.0, 1.0], "negatives": 10_000.0})
    assert is_figure(imbalance_by_height(data, tmp_path / "height"))
