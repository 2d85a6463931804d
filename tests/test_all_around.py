"""Without a camera: cars behind the picture, labels without a 2D box, from training to a score above 0."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.cli import main
from fl3d.data.calibration import AXES
from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import Labels, write_labels
from fl3d.evaluation.counts import count_labels
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.levels import Reason
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.scoring import ground_truths, score
from fl3d.evaluation.validation import read_validation
from fl3d.runs.layout import RunFolder
from fl3d.store.memory import MemoryStore
from fl3d.sweep.setup import Prepared
from tests.support import run_small, small_sweep

FRAMES = ("000001", "000005")  # those with most cars
AREA = "[-28.8,-9.6,0,9.6]"
WORDS = (
    *("detector=voxelnet", "protocol=lidar", "data.crop=none"),
    *("detector.range_velo=[-28.8,-9.6,-3,0,9.6,1]", f"protocol.ignore_beyond={AREA}"),
    *("protocol.overlaps.Car=[0.5,0.5,0.5]", "schedule.frames_per_epoch=8"),
    *("schedule.stages.warmup.epochs=18", "schedule.checkpoint_every=18"),
)


def turned(folder: KittiFolder, frame_id: str) -> tuple[np.ndarray, Labels]:
    """A frame turned by half about the sensor: what was before the car is behind it, out of any picture."""
    frame = folder.frame(frame_id)
    points, labels = frame.points_velo.copy(), frame.labels
    points[:, :2] *= -1
    boxes = frame.calibration.boxes_to_velo(labels.boxes_cam)
    boxes[:, :2] *= -1
    boxes[:, 6] += np.pi
    without = np.zeros_like(labels.boxes_image)
    cam = frame.calibration.boxes_to_cam(boxes)
    behind = replace(labels, boxes_cam=cam, boxes_image=without)
    return points, behind.select(labels.types != "DontCare")


@pytest.fixture(scope="module")
def around(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames for training and validation alike, so that few steps find their cars."""
    root = tmp_path_factory.mktemp("around")
    source, made = KittiFolder(simulated, crop="none"), KittiFolder(root)
    for kind in ("velodyne", "label_2", "calib"):
        made.path(kind, "0").parent.mkdir(parents=True)
    for frame_id in FRAMES:
        points, labels = turned(source, frame_id)
        points.tofile(made.path("velodyne", frame_id))
        write_labels(made.path("label_2", frame_id), labels)
        shutil.copy(source.path("calib", frame_id), made.path("calib", frame_id))
    (root / "ImageSets").mkdir()
    for name in ("train", "val"):
        (root / "ImageSets" / f"{name}.txt").write_text("\n".join(FRAMES) + "\n")
    return root


@pytest.fixture(scope="module")
def trained(around: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Prepared, MemoryStore]:
    root = tmp_path_factory.mktemp("trained")
    prepared = small_sweep(around, root, [[]], *WORDS)
    store = MemoryStore(prepared.settings.store.root)
    run_small(prepared, store=store)
    return prepared, store


def test_cars_behind_the_camera_are_found_and_scored(
    trained: tuple[Prepared, MemoryStore],
) -> None:
    prepared, store = trained
    scores = store.read(prepared.settings.experiment).iloc[-1]
    assert scores["ap_3d/moderate"] > 0
    assert scores["ap_bev_r40/easy"] > 0
    assert scores["recall_3d/0.5"] > 0
    assert not [name for name in scores.index if name.startswith("ap_image")]


def test_the_other_difficulties_score_the_same_detections(
    trained: tuple[Prepared, MemoryStore], around: Path
) -> None:
    prepared, _ = trained
    folder: RunFolder = prepared.layout.run(prepared.plan.trials[0].key)
    stored = read_detections(folder.detections(folder.steps()[-1]))
    validation = read_validation(KittiFolder(around, crop="none"), FRAMES)
    lidar = prepared.settings.protocol

    def scored(how: Protocol) -> dict[str, float]:
        return score(stored, validation, how)

    every = scored(replace(lidar, difficulty="none"))
    assert every["ap_3d/easy"] == every["ap_3d/moderate"] == every["ap_3d/hard"] > 0
    assert scored(replace(lidar, difficulty="points"))["ap_3d/hard"] > 0
    kept = json.loads(folder.scores(folder.steps()[-1], lidar.id).read_text())
    assert scored(lidar) == pytest.approx(kept)
    in_picture = scored(replace(lidar, difficulty="image"))
    assert {in_picture[name] for name in in_picture if name.startswith("ap_")} == {0.0}


def test_the_validation_labels_are_counted_beforehand(
    trained: tuple[Prepared, MemoryStore], around: Path
) -> None:
    lidar = trained[0].settings.protocol
    validation = read_validation(KittiFolder(around, crop="none"), FRAMES)
    gt, beyond, points = ground_truths(validation, lidar)
    counts = count_labels(gt, lidar, ["Car"], beyond, points)
    assert counts.counted["Car"]["hard"] > 0
    image = count_labels(gt, replace(lidar, difficulty="image"), ["Car"], beyond)
    assert image.is_empty
    assert set(image.ignored["Car"]["hard"]) <= {Reason.NO_BOX, Reason.OUTSIDE}
    gt, beyond, points = ground_truths(validation, replace(lidar, difficulty="points"))
    assert points is not None
    cars = gt.types == 0
    assert (points[cars & ~beyond] > 0).any()


def test_a_folder_without_calibrations_is_checked_and_scores_the_same(
    trained: tuple[Prepared, MemoryStore],
    around: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    prepared, _ = trained
    source = KittiFolder(around, crop="none")
    lidar_only = KittiFolder(tmp_path, crop="none", calibration="axes")
    shutil.copytree(around / "ImageSets", tmp_path / "ImageSets")
    shutil.copytree(around / "training" / "velodyne", tmp_path / "training" / "velodyne")
    (tmp_path / "training" / "label_2").mkdir()
    for frame_id in FRAMES:
        labels = source.read_labels(frame_id)
        boxes_velo = source.read_calibration(frame_id).boxes_to_velo(labels.boxes_cam)
        renamed = replace(labels, boxes_cam=AXES.boxes_to_cam(boxes_velo))
        write_labels(lidar_only.path("label_2", frame_id), renamed)
    words = [word for word in WORDS if not word.startswith("schedule")]
    picture = tmp_path / "frame.png"
    main(
        [
            *("check", str(tmp_path), *words, "profile=tiny", "data.calibration=axes"),
            *("--picture", str(picture)),
        ]
    )
    cars = sum(int((source.read_labels(i).types == "Car").sum()) for i in FRAMES)
    assert f"of {cars} labels of class Car, " in capsys.readouterr().out
    assert picture.exists()
    folder: RunFolder = prepared.layout.run(prepared.plan.trials[0].key)
    stored = read_detections(folder.detections(folder.steps()[-1]))
    protocol = prepared.settings.protocol
    expected = score(stored, read_validation(source, FRAMES), protocol)
    found = score(stored, read_validation(lidar_only, FRAMES), protocol)
    assert found == pytest.approx(expected, abs=2)  # labels are rounded to centimetres anew
