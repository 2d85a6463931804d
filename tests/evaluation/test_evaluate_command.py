"""What `evaluate` tells beside AP: what it counted, what it did not, why, and what looks like a mistake."""

import json
from pathlib import Path

import pytest

from fl3d.evaluation.average_precision import most_possible
from fl3d.evaluation.folders import evaluate_folder
from fl3d.evaluation.protocol import Protocol
from tests.evaluation.commanded import Printed, evaluate, row

KITTI = Protocol("kitti", "B", {"Car": (0.7, 0.7, 0.7)}, 0.0, 0.1, "standup", 100)


def line(
    kind: str = "Car",
    box: str = "300 150 420 230",
    occluded: str = "0",
    truncated: str = "0",
    place: str = "1 1.65 10",
    angle: str = "0",
    size: str = "1.5 1.6 3.9",
    score: object = "",
) -> str:
    return f"{kind} {truncated} {occluded} 0.46 {box} {size} {place} {angle} {score}".strip() + "\n"


class Folders:
    """A folder of labels and one of results."""

    def __init__(self, root: Path) -> None:
        self.labels, self.results = root / "label_2", root / "res"
        self.labels.mkdir()
        self.results.mkdir()

    def add(self, name: str, labels: str | None, results: str | None) -> None:
        for folder, text in ((self.labels, labels), (self.results, results)):
            if text is not None:
                (folder / f"{name}.txt").write_text(text)

    def add_perfect(self, n: int) -> None:
        for i in range(n):
            self.add(f"{i:06d}", line(), line(score=0.5 + i / 1000))


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path)


def test_labels_and_results_that_do_not_count_are_told(folders: Folders, capsys: Printed) -> None:
    low, flat = "300 150 420 180", "0 0 0 0"  # 30 px; no box
    truths = [
        *(line(), line(box=low), line(box=flat), line(occluded="2"), line(occluded="5")),
        *(line(truncated="0.4"), line("Van"), line("Truck"), line("Truck"), line("Bus")),
        line("DontCare", occluded="-1", truncated="-1", size="-1 -1 -1", angle="-10"),
    ]
    found = [line(score=0.9), line(box=low, score=0.8), line("Bus", score=0.7)]
    folders.add("000001", "".join(truths), "".join(found))
    code, out, err = evaluate(capsys, folders.labels, folders.results)
    assert (code, err) == (0, "")
    assert row(out, "3d")[-1] == "1/2/4"
    told = out.splitlines()
    assert (
        "- Car: 1 without a 2D box; 1/0/0 not higher than 40/25/25 px; 1 occlusion beyond KITTI's 3; "
        "1/1/0 occluded more than 0/1/2; 1/1/0 truncated more than 0.15/0.3/0.5" in told
    )
    assert "- neither hits nor misses: Van 1 (for Car)" in told
    assert "- other classes: Truck 2, Bus 1" in told
    assert any(one.startswith("- DontCare regions: 1;") for one in told)
    assert "- Car: 1/0/0 lower than 40/25/25 px" in told
    assert "- other classes: Bus 1" in told
    assert all(len(one) <= 120 for one in told if one.startswith("|"))


def test_nothing_is_told_whose_count_is_0(folders: Folders, capsys: Printed) -> None:
    folders.add_perfect(41)
    code, out, err = evaluate(capsys, folders.labels, folders.results)
    assert (code, err) == (0, "")
    assert out.rstrip().endswith("n_gt: ground truths that count, easy/moderate/hard.")


@pytest.mark.parametrize("n", range(1, 61))
def test_the_most_that_can_be_reached_is_what_perfect_detections_reach(
    folders: Folders, n: int
) -> None:
    folders.add_perfect(n)
    curve = evaluate_folder(folders.labels, folders.results, KITTI).curves["Car"]["3d"]["easy"]
    assert (curve.ap_r11, curve.ap_r40) == most_possible(n)
    assert (most_possible(n) == (100.0, 100.0)) == (n >= 41)


def test_json_holds_numbers_of_ground_truths_and_reasons(
    folders: Folders, capsys: Printed, tmp_path: Path
) -> None:
    folders.add("000001", line() + line(occluded="3") + line("Truck"), line(score=1))
    file = tmp_path / "out.json"
    code, _, _ = evaluate(capsys, folders.labels, folders.results, "--json", file)
    assert code == 0
    cell = json.loads(file.read_text())["Car"]["bev"]["moderate"]
    assert (cell["n_gt"], cell["ignored"]) == (1, {"occluded": 1})


def test_classes_without_ground_truths_have_no_row_and_levels_without_no_number(
    folders: Folders, capsys: Printed
) -> None:
    folders.add("000001", line(occluded="2"), line(score=1))
    _, out, _ = evaluate(capsys, folders.labels, folders.results)
    assert row(out, "3d") == ["-", "-", "9.0909", "-", "-", "0.0000", "0/0/1"]
    assert "Pedestrian" not in out


def test_strangers_among_the_results_are_refused_and_notes_passed_over(
    folders: Folders, capsys: Printed
) -> None:
    folders.add_perfect(2)
    (folders.results / "README.txt").write_text("These are results.\n")
    (folders.results / "log.txt").write_text("")
    code, out, _ = evaluate(capsys, folders.labels, folders.results)
    assert code == 0
    assert "passed over: README.txt, log.txt." in out
    folders.add("000007", None, line(score=1))
    folders.add("scene_b", None, line(score=1))
    code, out, err = evaluate(capsys, folders.labels, folders.results)
    assert (code, out) == (2, "")
    assert "2 of 6 result files are of frames without a label file" in err
    assert "000007, scene_b" in err
    assert "--split FILE" in err


def test_a_split_says_which_frames(folders: Folders, capsys: Printed, tmp_path: Path) -> None:
    folders.add_perfect(4)
    folders.add("000009", None, line(score=1))
    folders.add("000010", line(), None)
    split = tmp_path / "val.txt"
    split.write_text("000001\n000010\n")
    words = (folders.labels, folders.results, "--split", split)
    code, out, _ = evaluate(capsys, *words)
    assert code == 0
    assert out.startswith("1 frames")
    assert "1 of 2 frames of the split have no result file: left out" in out
    code, out, _ = evaluate(capsys, *words, "--missing", "empty")
    assert out.startswith("2 frames")
    assert "1 of 2 frames of the split have no result file: counted as" in out
    assert row(out, "3d")[-1] == "2/2/2"
    split.write_text("000001\n000011\n")
    code, _, err = evaluate(capsys, *words)
    assert code == 2
    assert "1 of 2 frames have no label file" in err
    assert "000011" in err


def test_frames_may_have_any_name(folders: Folders, capsys: Printed) -> None:
    for name in ("a", "b-2", "000001", "1234567"):
        folders.add(name, line(), line(score=0.5))
    code, out, _ = evaluate(capsys, folders.labels, folders.results)
    assert code == 0
    assert row(out, "3d")[-1] == "4/4/4"


def test_no_frame_has_results(folders: Folders, capsys: Printed) -> None:
    folders.add("000001", line(), None)
    (folders.results / "log.txt").write_text("")
    for more in ((), ("--missing", "empty")):
        code, _, err = evaluate(capsys, folders.labels, folders.results, *more)
        assert code == 2
        assert "holds no file of any of the 1 frames to evaluate (000001), only log" in err


def test_results_a_folder_deeper_are_found_out(folders: Folders, capsys: Printed) -> None:
    folders.add("000001", line(), None)
    (folders.results / "data").mkdir()
    (folders.results / "data" / "000001.txt").write_text(line(score=1))
    code, _, err = evaluate(capsys, folders.labels, folders.results)
    assert code == 2
    assert "holds no file FRAME.txt, such as 000001.txt; its folder data does" in err


@pytest.mark.parametrize(
    ("truth", "found", "message"),
    [
        ("", line(score=1), "the labels of 1 frames hold no object"),
        (line("Van") + line("DontCare"), "", "Found: Van 1, DontCare 1; possible: Car, Pedestrian"),
        (line(occluded="3"), "", "of 1 labels (Car 1) none counts: 1 occluded more than 2"),
        (line(truncated="0.9"), "", "1 truncated more than 0.5"),
        (line(box="300 150 420 160"), "", "1 lower than 25 px"),
        (line(), line("Cars", score=1), "no result is of a class that counts. Found: Cars 1"),
        (line(), line(box="0 0 0 0", score=1), "none of 1 results has a 2D box"),
    ],
)
def test_why_nothing_could_be_evaluated(
    folders: Folders, capsys: Printed, truth: str, found: str, message: str
) -> None:
    folders.add("000001", truth, found)
    code, out, err = evaluate(capsys, folders.labels, folders.results)
    assert code == 2
    assert message in err
    assert "100" not in out
    assert "|" not in out


@pytest.mark.parametrize(
    ("truth", "found", "message"),
    [
        (line(angle="90"), line(score=1), "rotation_y of 1 labels is beyond 2 pi: degrees?"),
        (line(), line(angle="-179", score=1), "rotation_y of 1 results is beyond 2 pi: degrees?"),
        (line(), line(score=1) * 2, "all 2 results of Car have the score 1"),
        (line(), line(size="0 0 0", score=1), "none of the 1 results of Car has a 3D box"),
        (line(size="0 0 0"), line(score=1), "none of the 1 labels of Car has a 3D box"),
        (line(score=1), line(score=1), "labels have 16 fields a line, not 15"),
        (line(), "", "the result files hold no detection"),
        (line() + line("Cyclist"), line(score=1), "no result is a Cyclist"),
    ],
)
def test_what_looks_like_a_mistake_is_a_warning(
    folders: Folders, capsys: Printed, truth: str, found: str, message: str
) -> None:
    folders.add("000001", truth, found)
    code, out, err = evaluate(capsys, folders.labels, folders.results)
    assert code == 0
    assert f"fl3d: warning: {message}" in err
    assert "warning" not in out


def test_a_class_of_ones_own_that_nothing_is_of_is_a_warning(
    folders: Folders, capsys: Printed
) -> None:
    folders.add(
        "000001", line() + line("Van") + line("Cone"), line(score=1) + line("Post", score=1)
    )
    for name, told in (
        ("Cra", "Did you mean 'Car'? There are: Car, Cone, Post, Van"),
        ("cone", "Did you mean 'Cone'? There are: Car, Cone, Post, Van"),
        ("Tree", "changes nothing. There are: Car, Cone, Post, Van"),
    ):
        word = f"+overlaps.{name}=[0.5,0.5,0.5]"
        code, _, err = evaluate(capsys, folders.labels, folders.results, word)
        assert code == 0
        (warned,) = err.splitlines()
        assert f"no label or result is of class {name}, so its overlaps" in warned
        assert told.removeprefix("changes nothing. ") in warned
        assert ("Did you mean" in warned) == ("Did you mean" in told)
    for name in ("Cone", "Post"):  # of which there is a label, or a result
        word = f"+overlaps.{name}=[0.5,0.5,0.5]"
        assert (
            "no label or result" not in evaluate(capsys, folders.labels, folders.results, word)[2]
        )


def test_lidar_counts_all_around_by_distance(folders: Folders, capsys: Printed) -> None:
    places = ["1 1.65 10", "1 1.65 -40", "-60 1.65 0", "0 1.65 80"]
    truth = "".join(line(box="0 0 0 0", occluded="3", place=place) for place in places)
    found = "".join(
        line(box="-1 -1 -1 -1", place=place, score=0.9 - i / 10) for i, place in enumerate(places)
    )
    alarm = line(box="-1 -1 -1 -1", place="50 1.65 0", score=0.95)  # nothing is there
    folders.add("000001", truth, found + alarm)
    words = (folders.labels, folders.results, "--protocol", "lidar")
    code, out, _ = evaluate(capsys, *words)
    assert code == 0
    # Precision at the last hit: at easy the alarm, 50 m away, does not count; then 2 of 3 and 3 of 4.
    r11 = [f"{100 / 11 * p:.4f}" for p in (1, 2 / 3, 3 / 4)]
    assert row(out, "3d")[:3] == r11
    assert row(out, "3d")[-1] == "1/2/3"
    assert "- Car: 3/2/1 further away than 30/50/70 m" in out
    assert "- Car: 4/2/1 further away than 30/50/70 m" in out
    code, out, _ = evaluate(capsys, *words, "limits=[45,70,90]")
    assert row(out, "3d")[-1] == "2/3/4"


def test_a_hit_beyond_a_level_still_is_one(folders: Folders, capsys: Printed) -> None:
    folders.add("000001", line(place="0 1.65 29.9"), line(place="0 1.65 30.1", score=1))
    _, out, _ = evaluate(capsys, folders.labels, folders.results, "--protocol", "lidar")
    assert row(out, "3d")[0] == "9.0909"


def test_points_need_clouds(folders: Folders, capsys: Printed) -> None:
    folders.add_perfect(1)
    words = ("--protocol", "lidar", "difficulty=points")
    code, _, err = evaluate(capsys, folders.labels, folders.results, *words)
    assert code == 2
    assert "points needs the clouds" in err
