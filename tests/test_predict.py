"""Predictions from a checkpoint: on KITTI folders and on bare clouds; and what is refused."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import CheckpointError, DataError
from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import read_labels
from fl3d.inference.predict import predict
from fl3d.runs.layout import RunFolder
from tests.support import train


@pytest.fixture(scope="module")
def stage(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("stages")
    plan, stages = train(simulated, root, ["detector=voxelnet", "loss.gamma=0"])
    return stages / plan.trials[0].key


def test_every_cloud_of_a_kitti_folder_has_a_result_and_a_picture(
    stage: Path, simulated: Path, tmp_path: Path
) -> None:
    said: list[str] = []
    written = predict(stage, simulated, tmp_path / "out", score=0.01, say=said.append)
    ids = KittiFolder(simulated).split("trainval")
    assert [path.stem for path in written] == sorted(ids)
    assert sorted(path.stem for path in (tmp_path / "out").glob("*.png")) == sorted(ids)
    found = [read_labels(path, scored=True) for path in written]
    assert sum(len(labels) for labels in found) > 0
    scores = np.concatenate([labels.scores for labels in found if labels.scores is not None])
    assert scores.min() >= 0.01
    assert len(said) == 1  # all have a calibration of their own


def test_a_cut_takes_what_is_below_away(stage: Path, simulated: Path, tmp_path: Path) -> None:
    counts = []
    for score in (0.01, 0.99999):
        written = predict(
            stage,
            simulated,
            tmp_path / str(score),
            score=score,
            pictures=False,
            say=lambda line: None,
        )
        counts.append(sum(len(read_labels(path, scored=True)) for path in written))
    assert counts[0] > counts[1]
    assert not list(tmp_path.rglob("*.png"))


def test_a_bare_cloud_takes_the_mean_calibration_and_says_so(
    stage: Path, simulated: Path, tmp_path: Path
) -> None:
    cloud = sorted((simulated / "training" / "velodyne").glob("*.bin"))[0]
    scan = tmp_path / "scan.bin"
    shutil.copy(cloud, scan)
    said: list[str] = []
    (written,) = predict(stage, scan, tmp_path / "out", score=0.01, say=said.append)
    assert written.name == "scan.txt"
    assert "1 clouds have no calibration of their own: the mean of KITTI's training set" in said[-1]


def test_a_checkpoint_may_be_named(stage: Path, simulated: Path, tmp_path: Path) -> None:
    folder = RunFolder(stage)
    first = folder.steps()[0]
    said: list[str] = []
    predict(folder.weights(first), simulated, tmp_path, pictures=False, say=said.append)
    assert f"step {first}:" in said[0]


def test_what_is_not_there_is_refused(stage: Path, simulated: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"runs/stages/NAME"):
        predict(tmp_path, simulated, tmp_path / "out")
    with pytest.raises(CheckpointError, match=r"no weights\. Possible: .*\.pt"):
        predict(stage / "checkpoints" / "00000001.pt", simulated, tmp_path / "out")
    with pytest.raises(DataError, match=r"no cloud \(\*\.bin, \*\.npy, \*\.pcd\)"):
        predict(stage, tmp_path, tmp_path / "out")


@pytest.mark.parametrize("change", [{"wings": 2}, {"rpn": [8, 16, 32]}])
def test_a_checkpoint_of_another_version_says_of_which(
    stage: Path, simulated: Path, tmp_path: Path, change: dict[str, object]
) -> None:
    old = RunFolder(shutil.copytree(stage, tmp_path / "old"))
    spec = json.loads(old.spec.read_text())
    spec["stage"]["config"]["detector"] |= change
    old.spec.write_text(json.dumps(spec))
    with pytest.raises(
        CheckpointError, match=r"\.pt: made by another version of fl3d \(.*\), whose network"
    ):
        predict(old.path, simulated, tmp_path / "out")
    assert not (tmp_path / "out").exists()
