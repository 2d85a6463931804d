"""Detectors compared by their result files: gains and verdicts by hand arithmetic."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.compare import Compared, compare_detectors
from fl3d.analysis.compare_tables import text_of
from fl3d.analysis.detectors import Detector
from fl3d.analysis.differences import found_by_part
from fl3d.analysis.result_folders import hold
from fl3d.core.errors import ConfigError, DataError
from fl3d.evaluation.verdicts import Verdict
from tests.analysis.result_files import (
    BARE,
    FLAT,
    car,
    protocol,
    runs,
    write_labels_of,
    write_results,
)


def compared(labels: Path, *detectors: Detector, **options: object) -> Compared:
    held = hold(labels, detectors, protocol())
    return compare_detectors(held, n_resamples=500, **options)  # type: ignore[arg-type]


def cell(found: Compared, detector: str, metric: str, average: str = "R40") -> pd.Series:
    rows = found.cells
    is_it = (rows["detector"] == detector) & (rows["metric"] == metric)
    return rows[is_it & (rows["average"] == average) & (rows["difficulty"] == "moderate")].iloc[0]


def verdict(found: Compared, detector: str) -> pd.Series:
    return found.verdicts[found.verdicts["level"] == detector].iloc[0]


def test_ap_and_gain_by_hand(tmp_path: Path) -> None:
    """Of 20 cars 10 and all: k hits without a false alarm are k recall samples of precision 1."""
    a, b = runs(tmp_path, "half", [10]), runs(tmp_path, "all", [20])
    found = compared(write_labels_of(tmp_path), a, b)
    assert found.classes == ("Car",)
    for metric in ("image", "bev", "3d"):
        base, side = cell(found, "half", metric), cell(found, "all", metric)
        assert base["n_gt"] == side["n_gt"] == 20
        assert base["ap"] == pytest.approx(9 / 40 * 100)  # samples 1 to 9 of 40
        assert side["ap"] == pytest.approx(19 / 40 * 100)
        assert side["gain"] == pytest.approx(25.0)
        assert side["gain_low"] <= 25.0 <= side["gain_high"]
        assert np.isnan(base["gain"])
        r11 = cell(found, "all", metric, "R11")
        assert r11["ap"] == pytest.approx(5 / 11 * 100)  # samples 0, 4, 8, 12 and 16
        assert r11["gain"] == pytest.approx((5 - 3) / 11 * 100)  # the half has 0, 4 and 8


def test_one_run_each_has_no_verdict_and_no_star(tmp_path: Path) -> None:
    found = compared(
        write_labels_of(tmp_path), runs(tmp_path, "half", [10]), runs(tmp_path, "all", [20])
    )
    assert verdict(found, "all")["verdict"] == "none"
    assert verdict(found, "all")["gain_low"] > 0  # over frames alone it would be better
    assert not found.cells["marked"].any()


def test_three_runs_that_find_more_are_better_and_the_other_way_round_worse(tmp_path: Path) -> None:
    few, many = runs(tmp_path, "few", [10, 10, 10]), runs(tmp_path, "many", [20, 20, 20])
    labels = write_labels_of(tmp_path)
    found = compared(labels, few, many)
    assert verdict(found, "many")["verdict"] == "better"
    assert verdict(found, "many")["gain"] == pytest.approx(25.0)
    assert verdict(found, "few")["verdict"] == "baseline"
    marked = found.cells[found.cells["marked"]]
    assert set(marked["detector"]) == {"many"}
    assert set(marked["average"]) == {"R40"}
    other = compared(labels, few, many, baseline="many")
    assert verdict(other, "few")["verdict"] == "worse"
    assert verdict(other, "few")["gain"] == pytest.approx(-25.0)


def test_the_same_detections_gain_exactly_nothing(tmp_path: Path) -> None:
    """However its runs differ among themselves."""
    a, b = runs(tmp_path, "a", [8, 12, 10]), runs(tmp_path, "b", [8, 12, 10])
    labels = write_labels_of(tmp_path)
    found = compared(labels, a, b)
    rows = found.cells[found.cells["detector"] == "b"]
    assert (rows[["gain", "gain_low", "gain_high"]] == 0).all(axis=None)
    assert verdict(found, "b")["verdict"] == "equivalent"
    one = compared(labels, Detector("a", a.folders[:1]), Detector("b", b.folders[:1]))
    assert verdict(one, "b")["verdict"] == "none"
    assert verdict(one, "b")["gain"] == verdict(one, "b")["gain_high"] == 0


def test_runs_that_disagree_are_undecided(tmp_path: Path) -> None:
    """+10, 0 and -10 AP: t with two degrees of freedom reaches 24.8 AP to either side."""
    a, b = runs(tmp_path, "a", [10, 10, 10]), runs(tmp_path, "b", [14, 10, 6])
    row = verdict(compared(write_labels_of(tmp_path), a, b), "b")
    assert row["verdict"] == "undecided"
    assert row["gain"] == pytest.approx(0.0)
    assert row["spread"] == pytest.approx(10.0)
    assert row["gain_high"] >= 4.3027 * 10 / np.sqrt(3) - 1e-3


def test_unlike_numbers_of_runs_are_paired_as_far_as_they_go_and_told(tmp_path: Path) -> None:
    a, b = runs(tmp_path, "a", [10, 10, 10]), runs(tmp_path, "b", [20, 20, 20, 2])
    found = compared(write_labels_of(tmp_path), a, b)
    assert verdict(found, "b")["seeds"] == 3
    assert "b has 4 runs and a 3: the first 3 of each are paired." in found.notes


def test_copied_runs_are_told(tmp_path: Path) -> None:
    a = runs(tmp_path, "a", [10, 11, 12])
    copies = tuple(write_results(tmp_path / f"copy{i}", 20) for i in range(3))
    found = compared(write_labels_of(tmp_path), a, Detector("b", copies))
    assert found.notes == ("Runs of b have the same detections: they are no runs of their own.",)
    row = verdict(found, "b")
    assert (row["verdict"], row["seeds"]) == (Verdict.NONE, 1)
    assert row["gain"] == pytest.approx(25.0)  # 20 of 20 and 10 of 20: 19 and 9 samples of 40
    assert not found.cells["marked"].any()
    text = text_of(found)
    assert "b: no verdict: runs 1, 2, 3 have the same detections, and count as one." in text
    assert "**" not in text
    assert "better" not in text.partition("Better, worse")[0]


def test_copied_runs_of_the_baseline_are_told_of_the_others(tmp_path: Path) -> None:
    copies = tuple(write_results(tmp_path / f"copy{i}", 20) for i in range(3))
    b = runs(tmp_path, "b", [10, 11, 12])
    found = compared(write_labels_of(tmp_path), Detector("a", copies), b)
    assert verdict(found, "b")["verdict"] == Verdict.NONE
    assert "b: no verdict: the baseline's runs 1, 2, 3 have the same" in text_of(found)


def test_one_folder_under_two_names_is_refused(tmp_path: Path) -> None:
    labels = write_labels_of(tmp_path)
    a = runs(tmp_path, "a", [10, 11])
    again = Detector("b", (tmp_path / "other" / ".." / a.folders[1].name,))
    (tmp_path / "other").mkdir()
    with pytest.raises(ConfigError, match=r"b: \S+a1 is the folder that stands for a run of a"):
        hold(labels, [a, again], protocol())


def test_a_run_that_finds_nothing_has_ap_0_and_is_named(tmp_path: Path) -> None:
    """As in a sweep: of three runs two find all, 19 of 40 samples, and one has collapsed."""
    a, b = runs(tmp_path, "a", [10, 10, 10]), runs(tmp_path, "b", [20, 0, 20])
    found = compared(write_labels_of(tmp_path), a, b)
    for metric in ("image", "bev", "3d"):
        assert cell(found, "b", metric)["ap"] == pytest.approx(2 / 3 * 19 / 40 * 100)
    row = verdict(found, "b")
    assert (row["seeds"], row["gain"]) == (3, pytest.approx((25 - 22.5 + 25) / 3))
    assert row["verdict"] == Verdict.UNDECIDED
    assert found.notes == (f"b has no detection of Car in {b.folders[1]}: AP 0 there.",)
    shares = found_by_part(found, "Car", n_resamples=50)
    own = shares[(shares["detector"] == "b") & (shares["bin"] == "20–30 m")].iloc[0]
    assert own["found"] == pytest.approx(200 / 3)


def test_a_difficulty_without_ground_truths_has_no_ap_and_no_verdict(tmp_path: Path) -> None:
    """All cars are largely occluded: they count as hard, and neither easy nor moderate."""
    labels = write_labels_of(tmp_path, [car(occluded=2)] * 20)
    found = compared(labels, runs(tmp_path, "a", [10, 11, 12]), runs(tmp_path, "b", [20, 20, 19]))
    row = verdict(found, "b")
    assert (row["verdict"], row["open"]) == (Verdict.NONE, False)
    assert np.isnan(row[["ap", "ap_low", "ap_high", "gain"]].astype(float)).all()
    moderate = cell(found, "b", "3d")
    assert moderate["n_gt"] == 0
    assert np.isnan(moderate[["ap", "gain"]].astype(float)).all()
    hard = found.cells[(found.cells["difficulty"] == "hard") & (found.cells["detector"] == "b")]
    assert (hard["gain"] > 0).all()
    assert hard[hard["average"] == "R40"][
        "marked"
    ].all()  # cells without a number take nothing away
    text = text_of(found)
    assert "b: no verdict: no ground truth counts." in text
    assert "neither finds anything" not in text
    assert "nan" not in text


def test_a_detector_that_finds_nothing_in_any_run_has_no_ap(tmp_path: Path) -> None:
    a, b = runs(tmp_path, "a", [10, 10, 10]), runs(tmp_path, "b", [0, 0, 0])
    with pytest.raises(ConfigError, match=r"b has no detection of Car: no AP and no gain"):
        compared(write_labels_of(tmp_path), a, b)


def test_a_collapsed_run_makes_no_3d_boxes_of_2d_ones(tmp_path: Path) -> None:
    flat = (
        write_results(tmp_path / "flat", 20, lambda _: FLAT),
        write_results(tmp_path / "none", 0),
    )
    found = compared(
        write_labels_of(tmp_path), runs(tmp_path, "whole", [10, 11]), Detector("flat", flat)
    )
    assert cell(found, "flat", "3d")[["ap", "gain"]].isna().all()
    assert cell(found, "flat", "image")["ap"] == pytest.approx(19 / 80 * 100)


def test_2d_boxes_alone_have_no_3d_gain_and_it_is_said(tmp_path: Path) -> None:
    whole = runs(tmp_path, "whole", [10])
    flat = Detector("flat", (write_results(tmp_path / "flat", 20, lambda _: FLAT),))
    found = compared(write_labels_of(tmp_path), whole, flat)
    for metric in ("bev", "3d"):
        assert cell(found, "flat", metric)[["ap", "gain"]].isna().all()
    assert cell(found, "flat", "image")["gain"] == pytest.approx(25.0)
    assert set(found.verdicts["metric"]) == {"image_r40/moderate"}
    assert found.notes == (
        "flat has no bird's-eye and no 3D boxes of Car: no AP and no gain there.",
    )


def test_results_without_2d_boxes_are_refused_by_a_protocol_that_measures_them(
    tmp_path: Path,
) -> None:
    """By their heights none would count: the official evaluator gives 0."""
    labels = write_labels_of(tmp_path)
    bare = [
        Detector(str(n), (write_results(tmp_path / str(n), n, lambda _: BARE.format(z=20)),))
        for n in (10, 20)
    ]
    with pytest.raises(ConfigError, match=r"10 has no 2D boxes of Car.*--protocol lidar"):
        compared(labels, *bare)
    found = compare_detectors(hold(labels, bare, protocol("distance")), n_resamples=50)
    assert cell(found, "20", "3d")["gain"] == pytest.approx(25.0)
    assert set(found.cells["metric"]) == {"bev", "3d"}


def test_a_class_that_one_alone_detects_is_not_compared(tmp_path: Path) -> None:
    labels = write_labels_of(tmp_path)
    both = write_results(tmp_path / "both", 20)
    walker = car().replace("Car", "Pedestrian")
    (both / "000000.txt").write_text(f"{car()} 0.9\n{walker} 0.8\n")
    cars, other = runs(tmp_path, "cars", [10]), Detector("both", (both,))
    found = compared(labels, cars, other)
    assert found.classes == ("Car",)
    assert "no ground truth of it counts" in found.notes[0]
    with pytest.raises(ConfigError, match="Pedestrian is not compared: no ground truth of it"):
        compared(labels, cars, other, classes=["Pedestrian"])
    (labels / "000000.txt").write_text(f"{car()}\n{walker}\n")
    found = compared(labels, cars, other)
    alone = "Pedestrian is not compared. cars has no detection of Pedestrian: no AP and no gain."
    assert (found.classes, found.notes) == (("Car",), (alone,))
    with pytest.raises(ConfigError, match=f"nothing to compare. {alone}"):
        compared(labels, cars, other, classes=["pedestrian"])
    both = compared(labels, cars, other, classes=["Car", "pedestrian"])
    assert both.notes == (alone,)


def test_unknown_names_are_told_with_what_was_possible(tmp_path: Path) -> None:
    pair = (runs(tmp_path, "a", [10]), runs(tmp_path, "b", [20]))
    labels = write_labels_of(tmp_path)
    with pytest.raises(ConfigError, match=r"--baseline c: no such detector. .*Possible: a, b"):
        compared(labels, *pair, baseline="c")
    with pytest.raises(ConfigError, match=r"--classes Cat: .*Did you mean 'Car'"):
        compared(labels, *pair, classes=["Cat"])
    assert compared(labels, *pair, classes=["car"]).classes == ("Car",)


def test_a_frame_that_a_folder_lacks_is_an_error_unless_told_what_it_stands_for(
    tmp_path: Path,
) -> None:
    labels = write_labels_of(tmp_path)
    a, b = runs(tmp_path, "a", [10]), runs(tmp_path, "b", [20])
    for number in (3, 17):
        (b.folders[0] / f"{number:06d}.txt").unlink()
    with pytest.raises(ConfigError, match=r"b0 lacks 2 \(000003, 000017\) of 20 frames.*--missing"):
        hold(labels, [a, b], protocol())
    empty = hold(labels, [a, b], protocol(), missing="empty")
    found = compare_detectors(empty, n_resamples=50)
    assert (len(empty.ids), cell(found, "b", "3d")["ap"]) == (20, pytest.approx(17 / 40 * 100))
    skip = hold(labels, [a, b], protocol(), missing="skip")
    found = compare_detectors(skip, n_resamples=50)
    assert (len(skip.ids), cell(found, "b", "3d")["n_gt"]) == (18, 18)
    assert cell(found, "a", "3d")["ap"] == pytest.approx(8 / 40 * 100)  # it had found 000003
    assert "lacks 2" in found.notes[0]
    assert found.notes[0].endswith("left out for all.")


def test_a_split_says_on_which_frames(tmp_path: Path) -> None:
    labels = write_labels_of(tmp_path)
    pair = [runs(tmp_path, "a", [10]), runs(tmp_path, "b", [20])]
    split = tmp_path / "val.txt"
    split.write_text("000011\n000002\n000005\n")
    held = hold(labels, pair, protocol(), split=split)
    assert held.ids == ("000002", "000005", "000011")
    assert cell(compare_detectors(held, n_resamples=50), "b", "3d")["n_gt"] == 3


def test_folders_that_cannot_be_compared_are_named(tmp_path: Path) -> None:
    labels = write_labels_of(tmp_path)
    a = runs(tmp_path, "a", [10])
    with pytest.raises(ConfigError, match="two detectors are named 'a'"):
        hold(labels, [a, a], protocol())
    with pytest.raises(ConfigError, match="needs two detectors"):
        hold(labels, [a], protocol())
    with pytest.raises(ConfigError, match="a0 stands for two of its runs"):
        hold(labels, [Detector("a", a.folders * 2), runs(tmp_path, "b", [1])], protocol())
    with pytest.raises(DataError, match="nowhere: no such folder"):
        hold(labels, [a, Detector("c", (tmp_path / "nowhere",))], protocol())
    (tmp_path / "nothing").mkdir()
    with pytest.raises(DataError, match="nothing: holds no file"):
        hold(labels, [a, Detector("c", (tmp_path / "nothing",))], protocol())
    others = write_results(tmp_path / "others", 25, n=25)
    with pytest.raises(DataError, match=r"others: 5 of 25 .* without a label file"):
        hold(labels, [a, Detector("c", (others,))], protocol())


def test_drives_are_resampled_where_their_mapping_lies_beside_the_labels(tmp_path: Path) -> None:
    """Frames 0-4, 5-9, ... come from one drive each."""
    labels = write_labels_of(tmp_path)
    pair = [runs(tmp_path, "a", [10]), runs(tmp_path, "b", [20])]
    assert hold(labels, pair, protocol()).units.name == "frames"
    mapping = tmp_path / "mapping"
    mapping.mkdir()
    (mapping / "train_rand.txt").write_text(",".join(str(i + 1) for i in range(20)))
    drives = [f"2011_09_26 drive_{i // 5:04d} {i:010d}" for i in range(20)]
    (mapping / "train_mapping.txt").write_text("\n".join(drives))
    for given in (None, mapping):
        units = hold(labels, pair, protocol(), mapping=given).units
        assert (units.name, units.count) == ("drives", 4)
    with pytest.raises(DataError, match="no such folder of KITTI's mapping"):
        hold(labels, pair, protocol(), mapping=tmp_path / "none")
