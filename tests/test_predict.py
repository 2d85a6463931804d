"""Predictions from a checkpoint: on KITTI folders and on bare clouds; and what is refused."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fl3d.cli import main
from fl3d.core.errors import CheckpointError, ConfigError, DataError
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


def test_where_a_cloud_cannot_be_read_those_that_were_written_are_counted(
    stage: Path, simulated: Path, tmp_path: Path
) -> None:
    """The second of three is torn: one is written, and the folder holds that one."""
    (tmp_path / "velodyne").mkdir()
    clouds = sorted((simulated / "training" / "velodyne").glob("*.bin"))[:3]
    for cloud in clouds:
        shutil.copy(cloud, tmp_path / "velodyne")
    (tmp_path / "velodyne" / clouds[1].name).write_bytes(b"torn")
    said: list[str] = []
    out = tmp_path / "out"
    with pytest.raises(DataError, match=clouds[1].name):
        predict(stage, tmp_path, out, pictures=False, say=said.append)
    assert said[-1].endswith(f": 1 of 3 clouds into {out}")
    assert [path.stem for path in out.iterdir()] == [clouds[0].stem]


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


@pytest.fixture
def copy(simulated: Path, tmp_path: Path) -> Path:
    """A KITTI folder of two clouds."""
    root = tmp_path / "kitti"
    shutil.copytree(simulated, root)
    for cloud in sorted((root / "training" / "velodyne").iterdir())[2:]:
        cloud.unlink()
    return root


def result_texts(stage: Path, clouds: Path, out: Path, **more: Any) -> list[str]:
    written = predict(stage, clouds, out, score=0.01, pictures=False, say=lambda _: None, **more)
    return [path.read_text() for path in written]


def test_clouds_of_every_form_give_the_same_results(
    stage: Path, copy: Path, tmp_path: Path
) -> None:
    plain = result_texts(stage, copy, tmp_path / "plain")
    first, second = sorted((copy / "training" / "velodyne").iterdir())
    points = np.fromfile(first, dtype="<f4").reshape(-1, 4)
    first.unlink()
    np.save(first.with_suffix(".npy"), points)
    wide = np.fromfile(second, dtype="<f4").reshape(-1, 4).astype("<f8") * [1, 1, 1, 255]
    wide.tofile(second)
    with pytest.raises(DataError, match=r"looks like float64.*give data\.cloud\.dtype=float64"):
        result_texts(stage, copy, tmp_path / "refused")
    np.save(first.with_suffix(".npy"), points * np.array([1, 1, 1, 255], dtype="<f4"))
    reading = {"dtype": "float64", "reflectance_scale": 255}
    told = result_texts(stage, copy, tmp_path / "told", reading=reading)
    assert told == plain


def test_labels_are_read_for_pictures_alone(stage: Path, copy: Path, tmp_path: Path) -> None:
    for label in (copy / "training" / "label_2").iterdir():
        label.write_text("no label")
    assert len(result_texts(stage, copy, tmp_path / "out")) == 2
    with pytest.raises(DataError, match=r"label_2/\d+\.txt:1: 15 fields expected, found 2"):
        predict(stage, copy, tmp_path / "pictures", say=lambda _: None)


def test_labels_of_any_case_and_a_jpg_are_drawn(stage: Path, copy: Path, tmp_path: Path) -> None:
    pictures = copy / "training" / "image_2"
    pictures.mkdir()
    for label in (copy / "training" / "label_2").iterdir():
        label.write_text(label.read_text().replace("Car 0.00 0", "car -1 4"))
        Image.new("RGB", (1242, 375)).save(pictures / f"{label.stem}.jpg")
    predict(stage, copy, tmp_path / "out", say=lambda _: None)
    assert len(list((tmp_path / "out").glob("*.png"))) == 2


def test_the_command_takes_the_keys_that_its_errors_name(
    stage: Path, copy: Path, tmp_path: Path
) -> None:
    for cloud in (copy / "training" / "velodyne").iterdir():
        np.fromfile(cloud, dtype="<f4").astype("<f8").tofile(cloud)
    out = ["--out", str(tmp_path / "out"), "--no-pictures"]
    words = ["predict", str(stage), str(copy), *out]
    with pytest.raises(SystemExit, match=r"give data\.cloud\.dtype=float64"):
        main(words)
    main([*words, "data.cloud.dtype=float64", "data.image_size=[1242,375]"])
    assert len(list((tmp_path / "out").glob("*.txt"))) == 2
    for wrong, message in (
        ("data.cloud.type=float64", r"no key 'data\.cloud\.type=float64'\. Did you mean 'data"),
        ("data.cloud.columns=2", r"data\.cloud\.columns: 2, but"),
        ("data.image_size=7", r"data\.image_size: 7, but"),
    ):
        with pytest.raises(SystemExit, match=message):
            main([*words, wrong])


def test_a_missing_folder_and_a_device_that_is_not_there_are_named(
    stage: Path, simulated: Path, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=r"nowhere: no such file or folder"):
        predict(stage, tmp_path / "nowhere", tmp_path / "out")
    with pytest.raises(ConfigError, match=r"--device mps: no such device"):
        predict(stage, simulated, tmp_path / "out", device="mps")
    assert not (tmp_path / "out").exists()
