"""Where detectors differ: parts of the objects, and frames."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.compare import Compared, compare_detectors
from fl3d.analysis.detectors import Detector
from fl3d.analysis.differences import changed_frames, found_by_part, parts_of
from fl3d.analysis.result_folders import hold
from tests.analysis.result_files import N, car, protocol, runs, write_labels_of, write_results


def of_bin(rows: pd.DataFrame, by: str, name: str, detector: str) -> pd.Series:
    is_it = (rows["by"] == by) & (rows["bin"] == name) & (rows["detector"] == detector)
    return rows[is_it].iloc[0]


def far(number: int) -> str:
    """Frames in turn have a car 8 m and 35 m away."""
    return car(z=8.0 if number % 2 else 35.0)


@pytest.fixture
def near_sighted(tmp_path: Path) -> Compared:
    """A detector that finds near cars alone, and one that finds all."""
    labels = write_labels_of(tmp_path, [far(number) for number in range(N)])
    near = write_results(tmp_path / "near", range(1, N, 2), far)
    every = write_results(tmp_path / "every", N, far)
    pair = [Detector("near", (near,)), Detector("every", (every,))]
    return compare_detectors(hold(labels, pair, protocol()), n_resamples=50)


def test_shares_found_by_distance(near_sighted: Compared) -> None:
    rows = found_by_part(near_sighted, "Car", n_resamples=50)
    for name, detector, share, gain in (
        ("0–10 m", "near", 100, 0),
        ("0–10 m", "every", 100, 0),
        ("30–40 m", "near", 0, 0),
        ("30–40 m", "every", 100, 100),
    ):
        row = of_bin(rows, "distance", name, detector)
        assert (row["n_gt"], row["found"], row["gain"]) == (10, share, gain)
        assert (row["gain_low"], row["gain_high"]) == (gain, gain)
    empty = of_bin(rows, "distance", "10–20 m", "near")
    assert empty["n_gt"] == 0
    assert np.isnan(empty["found"])


def test_points_are_told_where_they_are_known(near_sighted: Compared) -> None:
    assert "points on it" not in set(found_by_part(near_sighted, "Car", n_resamples=5)["by"])
    points = np.where(np.arange(N) % 2, 700, 3)
    rows = found_by_part(near_sighted, "Car", points, n_resamples=5)
    assert of_bin(rows, "points on it", "from 500", "near")["found"] == 100
    assert of_bin(rows, "points on it", "1–4", "near")["found"] == 0
    assert of_bin(rows, "points on it", "1–4", "every")["n_gt"] == 10


def test_frames_with_the_largest_change_come_first(near_sighted: Compared) -> None:
    rows = changed_frames(near_sighted, "Car", "every")
    assert list(rows["change"]) == [1] * 10 + [0] * 10
    assert list(rows["frame"].head(3)) == ["000000", "000002", "000004"]
    assert (rows["found"] == 1).all()
    assert not rows[["alarms", "alarms_base"]].any(axis=None)


def test_sides_are_told_by_the_line_of_sight(tmp_path: Path) -> None:
    """Straight ahead a heading of -90 degrees drives away; 45 degrees to the right, one of -45 does."""
    quarter = np.pi / 4
    cars = [
        (car(ry=-np.pi / 2), "back"),
        (car(ry=np.pi / 2), "front"),
        (car(ry=0.0), "side"),
        (car(x=20.0, ry=-quarter), "back"),
        (car(x=-20.0, ry=quarter), "front"),
        (car(x=20.0, ry=quarter), "side"),
    ]
    labels = write_labels_of(tmp_path, [line for line, _ in cars])
    pair = [Detector(n, (write_results(tmp_path / n, 6, n=6),)) for n in ("a", "b")]
    gt = hold(labels, pair, protocol()).runs["a"][0].gt
    part = next(part for part in parts_of(gt) if part.name == "seen from")
    assert [part.bins[i] for i in part.of_objects] == [side for _, side in cars]


def test_runs_are_averaged(tmp_path: Path) -> None:
    labels = write_labels_of(tmp_path)
    pair = [runs(tmp_path, "a", [10, 10, 10]), runs(tmp_path, "b", [20, 16, 12])]
    found = compare_detectors(hold(labels, pair, protocol()), n_resamples=50)
    row = of_bin(found_by_part(found, "Car", n_resamples=50), "distance", "20–30 m", "b")
    assert (row["found"], row["gain"]) == (pytest.approx(80.0), pytest.approx(30.0))
