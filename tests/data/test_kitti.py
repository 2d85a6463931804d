"""Reading and writing KITTI, real and broken."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fl3d.config.compose import compose_config
from fl3d.core.errors import DataError
from fl3d.data.calibration import Calibration
from fl3d.data.calibration_files import read_calibration, write_calibration
from fl3d.data.clouds import read_cloud
from fl3d.data.dataset import Frames, TargetRule, epoch_order, subset
from fl3d.data.frame_digests import data_digest
from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import read_labels, write_labels

LINE = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62\n"


def test_a_label_line_is_read_field_by_field(tmp_path: Path) -> None:
    path = tmp_path / "000000.txt"
    path.write_text(LINE)
    labels = read_labels(path)
    assert labels.types.tolist() == ["Car"]
    assert labels.boxes_image.tolist() == [[614.24, 181.78, 727.31, 284.77]]
    assert labels.boxes_cam.tolist() == [[1.00, 1.75, 13.22, 1.57, 1.73, 4.15, 1.62]]
    assert labels.scores is None


def test_the_same_frames_split_elsewhere_are_other_data(simulated: Path) -> None:
    from fl3d.config.settings import read_settings
    from fl3d.sweep.prepare import prepare_data

    words = ["data.generate=false", "data.train_frames=null", "data.val_frames=null"]
    data = read_settings(compose_config([f"data.root={simulated}", *words])).data
    turned = replace(data, train_split=data.val_split, val_split=data.train_split)
    assert prepare_data(turned).digest != prepare_data(data).digest


def test_a_split_without_frames_is_named_with_its_key(simulated: Path, tmp_path: Path) -> None:
    from fl3d.config.settings import read_settings
    from fl3d.sweep.prepare import prepare_data

    shutil.copytree(simulated / "ImageSets", tmp_path / "ImageSets")
    (tmp_path / "training").symlink_to(simulated / "training")
    (tmp_path / "ImageSets/train.txt").write_text("")
    data = read_settings(compose_config([f"data.root={tmp_path}", "data.generate=false"])).data
    with pytest.raises(DataError, match=r"train\.txt: names no frame, and is data\.train_split"):
        prepare_data(data)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LINE + "Car 0.00 0 1.55 614.24\n", "000000.txt:2: 15 fields expected, found 5"),
        (LINE.replace("13.22", "nan"), "000000.txt:1: field 'z': 'nan' is not finite"),
        (LINE.replace("1.57", "tall"), "000000.txt:1: field 'height': 'tall' is not a number"),
    ],
)
def test_a_malformed_label_names_file_line_and_field(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "000000.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        read_labels(path)


def test_an_empty_label_file_has_no_objects(tmp_path: Path) -> None:
    path = tmp_path / "000000.txt"
    path.write_text("")
    labels = read_labels(path)
    assert len(labels) == 0
    assert labels.boxes_cam.shape == (0, 7)


def test_written_labels_read_back(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(LINE)
    write_labels(tmp_path / "b.txt", read_labels(path))
    assert (tmp_path / "b.txt").read_text() == LINE


def test_a_cloud_cut_within_a_point_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(b"\0" * 30)
    with pytest.raises(DataError, match=r"000000\.bin: 30 bytes"):
        read_cloud(path)


def test_a_calibration_that_lacks_a_matrix_or_a_value_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "000000.txt"
    path.write_text("P2: 1 2 3\n")
    with pytest.raises(DataError, match=r"000000\.txt:1: P2 needs 12 values .*, found 3"):
        read_calibration(path)
    path.write_text("P2: " + "1 " * 12 + "\n")
    with pytest.raises(DataError, match=r"no line for R0_rect, Tr_velo_to_cam \(found: P2\)"):
        read_calibration(path)


def test_a_missing_split_lists_those_present(simulated: Path) -> None:
    with pytest.raises(DataError, match="Possible: train, trainval, val"):
        KittiFolder(simulated).split("trainn")


def test_a_split_that_names_an_unknown_frame_is_named(simulated: Path, tmp_path: Path) -> None:
    (tmp_path / "training").symlink_to(simulated / "training")
    (tmp_path / "ImageSets").mkdir()
    (tmp_path / "ImageSets/val.txt").write_text("000000\n123456\n")
    with pytest.raises(DataError, match=r"ImageSets/val\.txt: there is no frame 123456"):
        KittiFolder(tmp_path).split("val")


def test_a_missing_frame_names_its_file(simulated: Path) -> None:
    with pytest.raises(DataError, match=r"calib/999999\.txt: no such file"):
        KittiFolder(simulated).frame("999999")


def test_boxes_survive_the_way_to_the_lidar_and_back(kitti_sample: Path) -> None:
    folder = KittiFolder(kitti_sample)
    for frame_id in folder.split("sample_val"):
        calibration, labels = folder.read_calibration(frame_id), folder.read_labels(frame_id)
        cars = labels.boxes_cam[labels.types == "Car"]
        back = calibration.boxes_to_cam(calibration.boxes_to_velo(cars))
        np.testing.assert_allclose(back[:, :6], cars[:, :6], atol=1e-6)
        np.testing.assert_allclose(np.cos(back[:, 6] - cars[:, 6]), 1, atol=1e-12)


def test_calibration_files_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    turns = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2)]
    turns = [turn * np.linalg.det(turn) for turn in turns]  # rotations, not mirrors
    P2 = np.abs(rng.normal(size=(3, 4)))
    calibration = Calibration(P2, turns[0], np.column_stack([turns[1], rng.normal(size=3)]))
    write_calibration(tmp_path / "c.txt", calibration)
    back = read_calibration(tmp_path / "c.txt")
    np.testing.assert_allclose(back.P2, calibration.P2, rtol=1e-12)
    np.testing.assert_allclose(back.velo_to_rect, calibration.velo_to_rect, rtol=1e-11)


def test_real_splits_have_the_papers_sizes(kitti_sample: Path) -> None:
    folder = KittiFolder(kitti_sample)
    assert [len(folder.split(name)) for name in ("train", "val", "sample_train", "sample_val")] == [
        3712,
        3769,
        22,
        10,
    ]


def test_real_cars_hold_points_of_their_cloud(kitti_sample: Path) -> None:
    """Frames, boxes and calibration fit together: nearly every near, visible car has points inside its box."""
    folder = KittiFolder(kitti_sample)
    rule = TargetRule(min_points=1)
    found = visible = 0
    for frame_id in folder.split("sample"):
        frame = folder.frame(frame_id)
        found += len(rule.boxes_velo(frame))
        visible += int((frame.labels.types == "Car").sum())
    assert visible == 167
    assert found > 0.9 * visible


def test_the_crop_keeps_what_the_camera_sees(kitti_sample: Path) -> None:
    """About 18.7 thousand of 120 thousand points."""
    whole, seen = (
        KittiFolder(kitti_sample, crop=crop).frame("000010") for crop in ("none", "image")
    )
    assert 100_000 < len(whole.points_velo) < 130_000
    assert 12_000 < len(seen.points_velo) < 25_000
    assert (seen.points_velo[:, 0] > 0).all()


def test_boxes_with_fewer_than_ten_points_are_no_targets(simulated: Path) -> None:
    folder = KittiFolder(simulated)
    frames = [folder.frame(i) for i in folder.split("train")]
    counts = {
        n: sum(len(TargetRule(min_points=n).boxes_velo(f)) for f in frames) for n in (0, 9, 10, 11)
    }
    assert counts[0] > counts[9] >= counts[10] >= counts[11] > 0


def test_the_mean_calibration_replaces_every_frames_own(kitti_sample: Path) -> None:
    own, mean = (
        KittiFolder(kitti_sample, calibration=kind).read_calibration("000003")
        for kind in ("frame", "mean")
    )
    assert not np.array_equal(own.P2, mean.P2)
    np.testing.assert_allclose(own.P2, mean.P2, atol=5)


def test_the_digest_knows_content_not_place(simulated: Path, tmp_path: Path) -> None:
    import shutil

    ids = KittiFolder(simulated).split("train")
    copy = tmp_path / "copy"
    shutil.copytree(simulated, copy)
    assert data_digest(KittiFolder(copy), ids) == data_digest(KittiFolder(simulated), ids)
    picture = copy / "training" / "image_2" / f"{ids[0]}.png"
    picture.parent.mkdir()
    Image.new("RGB", (1224, 370)).save(picture)
    assert data_digest(KittiFolder(copy), ids) != data_digest(
        KittiFolder(simulated), ids
    )  # another size crops otherwise
    picture.unlink()
    label = copy / "training" / "label_2" / f"{ids[0]}.txt"
    label.write_text(label.read_text() + LINE)
    assert data_digest(KittiFolder(copy), ids) != data_digest(KittiFolder(simulated), ids)


def test_frames_are_kept_up_to_the_limit(simulated: Path, tmp_path: Path) -> None:
    folder = KittiFolder(shutil.copytree(simulated, tmp_path / "copy"))
    frames = Frames(folder, folder.split("train"), cache=1)
    assert frames[0] is frames[0]
    assert frames[1] is not frames[1]
    none = Frames(folder, folder.split("train"), cache=0)
    assert none[0] is not none[0]


def test_stages_that_follow_one_another_read_a_frame_once(simulated: Path, tmp_path: Path) -> None:
    root = shutil.copytree(simulated, tmp_path / "copy")
    ids = KittiFolder(root).split("train")
    first = Frames(KittiFolder(root), ids, cache=10)[1]
    again = Frames(KittiFolder(root), ids[1:], cache=10)[0]
    assert again.points_velo is first.points_velo
    uncropped = Frames(KittiFolder(root, crop="none"), ids, cache=10)[1]
    assert len(uncropped.points_velo) > len(first.points_velo)


def test_a_kept_frame_is_read_anew_where_any_of_its_files_has_changed(
    simulated: Path, tmp_path: Path
) -> None:
    root = shutil.copytree(simulated, tmp_path / "copy")
    folder = KittiFolder(root)
    frames = Frames(folder, folder.split("train")[:1], cache=10)
    before = frames[0]
    label = folder.path("label_2", before.id)
    label.write_text(label.read_text() + LINE)
    assert len(frames[0].labels.types) == len(before.labels.types) + 1
    cloud = folder.path("velodyne", before.id)
    cloud.write_bytes(cloud.read_bytes()[: 16 * 100])
    assert len(frames[0].points_velo) <= 100 < len(before.points_velo)


def test_a_kept_frame_has_the_boxes_of_the_classes_that_are_asked_for(
    simulated: Path, tmp_path: Path
) -> None:
    """Boxes of a 2D detector are read by class, clouds are not."""
    root = shutil.copytree(simulated, tmp_path / "copy")
    ids = KittiFolder(root).split("train")[:1]
    found = root / "rgb_detections"
    found.mkdir(exist_ok=True)
    lines = [f"image_2/{ids[0]}.png {kind} 0.9 10 10 50 60\n" for kind in (1, 2, 2)]
    (found / "rgb_detection_train.txt").write_text("".join(lines))
    cars = Frames(KittiFolder(root), ids, cache=10)[0]
    people = Frames(KittiFolder(root, classes=("Pedestrian",)), ids, cache=10)[0]
    assert cars.points_velo is people.points_velo
    for frame, n, kind in ((cars, 2, "Car"), (people, 1, "Pedestrian")):
        assert frame.image_boxes is not None
        assert len(frame.image_boxes) == n
        assert frame.image_types is not None
        assert set(frame.image_types) == {kind}


def test_every_epoch_has_its_own_order_and_each_pass_every_frame() -> None:
    first, second = epoch_order(10, 2, seed=0, epoch=0), epoch_order(10, 2, seed=0, epoch=1)
    assert sorted(first[:10]) == sorted(first[10:]) == list(range(10))
    assert first.tolist() != second.tolist()
    assert first.tolist() == epoch_order(10, 2, seed=0, epoch=0).tolist()


def test_a_subset_is_seeded_and_keeps_the_order() -> None:
    ids = [f"{i:06d}" for i in range(100)]
    chosen = subset(ids, 10, seed=1)
    assert chosen == sorted(chosen) == subset(ids, 10, seed=1) != subset(ids, 10, seed=2)
    assert subset(ids, None, 0) == ids == subset(ids, 100, 0)
