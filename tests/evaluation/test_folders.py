"""`python -m fl3d evaluate`: a drop-in for any folder of KITTI results."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fl3d.config.compose import CONF, compose_config
from fl3d.core.errors import ConfigError, DataError
from fl3d.evaluation.folders import evaluate_folder
from fl3d.evaluation.protocol import Protocol

GT = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62\n"
DET = GT.strip() + " 0.95\n"


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    labels, results = tmp_path / "labels", tmp_path / "results"
    labels.mkdir()
    results.mkdir()
    for i in range(3):
        (labels / f"{i:06d}.txt").write_text(GT)
    (results / "000000.txt").write_text(DET)
    (results / "000001.txt").write_text("")
    (results / "notes.txt").write_text("not a frame")
    return labels, results


def protocol(name: str) -> Protocol:
    return Protocol(**compose_config([f"protocol={name}", "profile=paper"])["protocol"])


def test_frames_with_a_file_count_empty_ones_too_others_not(folders: tuple[Path, Path]) -> None:
    found = evaluate_folder(*folders, protocol("kitti"))
    assert found.frames.ids == ("000000", "000001")
    assert found.frames.missing == {"000002"}
    assert found.frames.passed_over == ("notes.txt",)
    assert found.curves["Car"]["3d"]["moderate"].n_gt == 2


@pytest.mark.parametrize(
    ("name", "variant", "car", "person"),
    [
        ("paper", "A", [0.7, 0.5, 0.5], [0.5, 0.25, 0.25]),
        ("paper_sure", "A", [0.7, 0.5, 0.5], [0.5, 0.25, 0.25]),
        ("paper_strict", "A", [0.7, 0.7, 0.7], [0.5, 0.5, 0.5]),
        ("report", "A", [0.7, 0.7, 0.7], [0.5, 0.5, 0.5]),
        ("kitti", "B", [0.7, 0.7, 0.7], [0.5, 0.5, 0.5]),
        ("kitti_loose", "B", [0.7, 0.5, 0.5], [0.5, 0.25, 0.25]),
        ("lidar", "B", [0.7, 0.7, 0.7], [0.5, 0.5, 0.5]),
    ],
)
def test_the_named_protocols(
    name: str, variant: str, car: list[float], person: list[float]
) -> None:
    found = protocol(name)
    assert (found.variant, found.overlaps["Car"]) == (variant, car)
    assert found.overlaps["Pedestrian"] == found.overlaps["Cyclist"] == person


def test_there_are_no_other_protocols_untested() -> None:
    assert {p.stem for p in (CONF / "protocol").glob("*.yaml")} == {
        *("paper", "paper_sure", "paper_strict", "kitti", "kitti_loose", "report", "lidar")
    }


def test_the_command_writes_the_documented_json(folders: tuple[Path, Path], tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    command = [
        sys.executable,
        "-m",
        "fl3d",
        "evaluate",
        *map(str, folders),
        "--protocol",
        "paper",
        "--json",
        str(target),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=CONF.parent, check=False)
    assert done.returncode == 0, done.stderr
    assert "| Car   | 3d " in done.stdout
    curves = json.loads(target.read_text())
    assert set(curves) == {"Car", "Pedestrian", "Cyclist"}
    assert set(curves["Car"]) == {"image", "bev", "3d"}
    cell = curves["Car"]["3d"]["easy"]
    assert (cell["n_gt"], cell["tp"], cell["fp"], cell["thresholds"]) == (2, [1], [0], [0.95])
    assert cell["ap_r11"] == pytest.approx(100 / 11)


def test_bad_folders_are_named(folders: tuple[Path, Path], tmp_path: Path) -> None:
    labels, results = folders
    with pytest.raises(DataError, match="no such folder"):
        evaluate_folder(labels, tmp_path / "nowhere", protocol("kitti"))
    with pytest.raises(DataError, match="holds no file FRAME"):
        evaluate_folder(labels, tmp_path, protocol("kitti"))
    (results / "000009.txt").write_text("")
    with pytest.raises(DataError, match=r"000009; .*--split FILE"):
        evaluate_folder(labels, results, protocol("kitti"))


def test_boxes_without_extent_are_survived(folders: tuple[Path, Path]) -> None:
    (folders[1] / "000001.txt").write_text(
        DET.replace("1.73 4.15", "0.00 0.00") + DET.replace("1.73", "-1.73")
    )
    curves = evaluate_folder(*folders, protocol("kitti")).curves
    assert curves["Car"]["3d"]["moderate"].tp.tolist() == [1]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "protocol.score_threshold=abc",
            "protocol.score_threshold: 'abc' is not a number from 0 to 1",
        ),
        ("protocol.nms_iou=2", "protocol.nms_iou: '2' is not a number from 0 to 1"),
        ("protocol.max_detections=0", "protocol.max_detections: '0' is not a whole number"),
        ("protocol.variant=C", "protocol.variant: no choice 'C'"),
        ("protocol.ignore_beyond=[1,2]", "protocol.ignore_beyond"),
    ],
)
def test_values_that_no_protocol_has_are_named(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace(".", r"\.")):
        Protocol(**compose_config([override])["protocol"])


def test_a_folder_that_cannot_be_written_to_is_named(folders: tuple[Path, Path]) -> None:
    command = [
        sys.executable,
        "-m",
        "fl3d",
        "evaluate",
        *map(str, folders),
        "--json",
        "/proc/nowhere/x.json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=CONF.parent, check=False)
    assert done.returncode != 0
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert "| Car   | orientation |" in done.stdout
