"""Folders that people bring: each has its right number, or a line that says what is the matter, and exit code 2."""

import re
from pathlib import Path

import pytest

from tests.evaluation.commanded import Printed, evaluate, row

ALL = ["100.0000"] * 6
PERFECT = {
    "bom-labels": "120/120/120",
    "bom-results": "120/120/120",
    "ids-7-digits": "60/60/60",
    "ids-mixed-6-7-digits": "60/60/60",
}


@pytest.mark.parametrize("name", PERFECT)
def test_perfect_results_have_100(odd_inputs: Path, capsys: Printed, name: str) -> None:
    folder = odd_inputs / name
    code, out, err = evaluate(capsys, folder / "label_2", folder / "res")
    assert (code, err) == (0, "")
    for metric in ("image", "orientation", "bev", "3d"):
        assert row(out, metric) == [*ALL, PERFECT[name]]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no-2d-box-in-labels", "60 without a 2D box, so lower than 25 px.*--protocol lidar"),
        ("no-2d-box-minus1", "60 without a 2D box, so lower than 25 px.*--protocol lidar"),
        ("occluded-4", "60 occlusion beyond KITTI's 3.*--protocol lidar"),
        ("class-names-unknown", "Found: Vehicle 60; possible: Car, Pedestrian, Cyclist"),
    ],
)
def test_where_nothing_counts_a_line_says_why(
    odd_inputs: Path, capsys: Printed, name: str, message: str
) -> None:
    folder = odd_inputs / name
    code, out, err = evaluate(capsys, folder / "label_2", folder / "res")
    assert code == 2
    assert "|" not in out
    assert err.count("\n") == 1
    assert re.search(message, err)


@pytest.mark.parametrize("name", ["no-2d-box-in-labels", "no-2d-box-minus1", "occluded-4"])
def test_without_the_picture_they_have_100(odd_inputs: Path, capsys: Printed, name: str) -> None:
    folder = odd_inputs / name
    words = (folder / "label_2", folder / "res", "--protocol", "lidar")
    code, out, _ = evaluate(capsys, *words)
    assert code == 0
    assert row(out, "3d") == row(out, "bev") == [*ALL, "60/60/60"]
    assert "image" not in out
    code, out, _ = evaluate(capsys, *words, "difficulty=none")
    assert row(out, "3d") == ["100.0000", "100.0000", "60"]


def test_fewer_result_files(odd_inputs: Path, capsys: Printed) -> None:
    folder = odd_inputs / "fewer-result-files"
    words = (folder / "label_2", folder / "res")
    code, out, _ = evaluate(capsys, *words)
    assert code == 0
    assert "60 of 120 labels have no result file: left out" in out
    assert row(out, "3d") == [*ALL, "60/60/60"]
    code, out, _ = evaluate(capsys, *words, "--missing", "empty")
    assert "120 frames" in out
    assert row(out, "3d") == [*["54.5455"] * 3, *["50.0000"] * 3, "120/120/120"]


def test_a_small_set_says_what_it_can_reach(odd_inputs: Path, capsys: Printed) -> None:
    folder = odd_inputs / "small-set-perfect-10"
    code, out, _ = evaluate(capsys, folder / "label_2", folder / "res")
    assert code == 0
    assert row(out, "3d") == [*["27.2727"] * 3, *["22.5000"] * 3, "10/10/10"]
    assert "10 ground truths: 27.27 (R11) and 22.50 (R40) are the most" in out
