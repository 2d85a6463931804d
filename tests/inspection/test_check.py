"""A folder with one thing wrong, and what a check says of it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fl3d.cli import main
from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.data.kitti import KittiFolder
from fl3d.inspection.facts import gather, some_of
from fl3d.inspection.finding import Severity
from fl3d.inspection.summary import Checked, as_json, checked
from fl3d.inspection.wanted import Wanted, wanted_by

TRAIN = [f"{k:06d}" for k in range(6)]
VAL = [f"{k:06d}" for k in range(6, 10)]


@pytest.fixture
def folder(simulated: Path, tmp_path: Path) -> Path:
    """A copy of a small simulated folder: 6 training and 4 validation frames."""
    return shutil.copytree(simulated, tmp_path / "data")


def look(root: Path, *words: str) -> Checked:
    """Check a folder as a sweep with these words would."""
    config = compose_config(["data=kitti", *words])
    settings = read_settings(config)
    splits = {"train": TRAIN, "val": VAL}
    facts = gather(settings.data.folder(root), splits, wanted_by([config]), settings.protocol, None)
    return checked(facts, "train", "val")


def texts(result: Checked, root: Path) -> list[str]:
    return [finding.text(root) for finding in result.findings]


def label_rows(root: Path, ids: list[str]) -> list[list[str]]:
    """Fields of every label line."""
    files = [root / "training" / "label_2" / f"{i}.txt" for i in ids]
    return [line.split() for file in files for line in file.read_text().splitlines()]


def change_labels(root: Path, change: Callable[[list[str]], list[str]]) -> None:
    """Change the fields of every label line."""
    for file in sorted((root / "training" / "label_2").iterdir()):
        rows = [change(line.split()) for line in file.read_text().splitlines()]
        file.write_text("".join(f"{' '.join(row)}\n" for row in rows))


def change_clouds(root: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change every cloud (N, 4)."""
    for file in sorted((root / "training" / "velodyne").iterdir()):
        points = np.fromfile(file, dtype=np.float32).reshape(-1, 4)
        change(points.copy()).astype(np.float32).tofile(file)


def with_field(number: int, value: str, only: str = "") -> Callable[[list[str]], list[str]]:
    """Sets a field of label lines, of one class or of all but DontCare."""

    def change(row: list[str]) -> list[str]:
        own = row[0] == only if only else row[0] != "DontCare"
        return [*row[:number], value, *row[number + 1 :]] if own else row

    return change


def with_sizes(order: tuple[int, int, int], scale: float = 1.0) -> Callable[[list[str]], list[str]]:
    """Puts height, width and length (fields 8 to 10) into another order, or another unit."""

    def change(row: list[str]) -> list[str]:
        sizes = [f"{float(row[8 + k]) * scale:.4f}" for k in order]
        return row if row[0] == "DontCare" else [*row[:8], *sizes, *row[11:]]

    return change


def test_a_folder_in_order_has_no_finding_and_its_numbers_are_told(folder: Path) -> None:
    result = look(folder)
    assert result.findings == ()
    cars = [row for row in label_rows(folder, TRAIN) if row[0] == "Car"]
    assert f"learnt from (train): 6 frames; of {len(cars)} labels of class Car, " in result.lines[0]
    own = [row for row in label_rows(folder, VAL) if row[0] == "Car"]
    assert f"of {len(own)}" in result.lines[1]
    assert result.lines[1].startswith("evaluated (val): 4 frames; count: Car ")
    files = [folder / "training" / "velodyne" / f"{i}.bin" for i in TRAIN]
    mean = np.mean([file.stat().st_size / 16 for file in files])
    assert result.lines[2].startswith(f"points: {mean:,.0f} a frame, ")


def test_targets_are_those_that_the_detector_learns_from(folder: Path) -> None:
    config = compose_config(["data=kitti", "detector=fcn3d"])
    (wanted,) = wanted_by([config])
    kitti = KittiFolder(folder)
    facts = gather(kitti, {"train": TRAIN}, (wanted,), read_settings(config).protocol, None)
    from fl3d.inference.load import build_detector

    detector = build_detector(config)
    cells = 0
    for frame_id in TRAIN:
        boxes = detector.targets.boxes_velo(kitti.frame(frame_id))
        x0, y0, _, x1, y1, _ = config["detector"]["range_velo"]
        inside = (boxes[:, 0] >= x0) & (boxes[:, 0] < x1) & (boxes[:, 1] >= y0) & (boxes[:, 1] < y1)
        cells += int(inside.sum())
    assert facts.targets("train", wanted) == cells > 0


# What is changed, and what a warning says of it.
ODD_LABELS = {
    "degrees": (with_field(14, "90.00"), "turned by more than 2 pi. Are the angles in degrees?"),
    "occlusion": (with_field(2, "5"), "an occlusion that KITTI does not have"),
    "truncation": (with_field(1, "2.00"), "a truncation that KITTI does not have"),
    "order": (with_sizes((2, 1, 0)), "are order and unit right?"),
    "unit": (with_sizes((0, 1, 2), 1000.0), "are order and unit right?"),
    "height": (with_field(12, "-30.00"), "Do boxes and clouds fit?"),
}


@pytest.mark.parametrize("kind", ODD_LABELS)
def test_labels_that_look_odd_are_warned_of(folder: Path, kind: str) -> None:
    change, expected = ODD_LABELS[kind]
    change_labels(folder, change)
    assert any(expected in text for text in texts(look(folder), folder)), texts(
        look(folder), folder
    )


def shifted(points: np.ndarray) -> np.ndarray:
    return points + np.array([5e5, 5.8e6, 0, 0])


def thinned_and_broken(points: np.ndarray) -> np.ndarray:
    points[:3, 0] = np.nan
    return points


ODD_CLOUDS = {
    "map": (shifted, "Coordinates of a map?"),
    "millimetres": (
        lambda points: points * np.array([1e3, 1e3, 1e3, 1]),
        "Millimetres, or another unit?",
    ),
    "reflectance": (
        lambda points: points * np.array([1, 1, 1, 255]),
        "data.cloud.reflectance_scale=255",
    ),
    "no reflectance": (
        lambda points: points * np.array([1, 1, 1, 0]),
        "every reflectance is 0",
    ),
    "not finite": (thinned_and_broken, "3 points are not finite"),
    "empty": (lambda points: points[:0], "no points."),
    "mirrored": (
        lambda points: points * np.array([1, -1, 1, 1]),
        "hold 10 points, 5 of them in the upper half. Do boxes and clouds fit?",
    ),
    "sparse": (lambda points: points[:100], "only 100 points."),
}


@pytest.mark.parametrize("kind", ODD_CLOUDS)
def test_clouds_that_look_odd_are_warned_of(folder: Path, kind: str) -> None:
    change, expected = ODD_CLOUDS[kind]
    change_clouds(folder, change)
    assert any(expected in text for text in texts(look(folder), folder))


def change_calibrations(root: Path, name: str, values: str) -> None:
    for file in sorted((root / "training" / "calib").iterdir()):
        lines = [line for line in file.read_text().splitlines() if not line.startswith(name)]
        file.write_text("".join(f"{line}\n" for line in [*lines, f"{name}: {values}"]))


ODD_CALIBRATIONS = {
    "inverse": ("0 0 1 0 -1 0 0 0 0 -1 0 0", "is Tr_velo_to_cam its inverse, camera to LiDAR"),
    "identity": ("1 0 0 0 0 1 0 0 0 0 1 0", "x is +x, y is +y, z is +z"),
    "backwards": ("0 1 0 0 0 0 -1 0 -1 0 0 0", "but along -x"),
    "millimetres": ("0 -1 0 0 0 0 -1 -80 1 0 0 -270", "the camera is 281.6 m from the LiDAR"),
}


@pytest.mark.parametrize("kind", ODD_CALIBRATIONS)
def test_calibrations_that_look_odd_are_warned_of(folder: Path, kind: str) -> None:
    values, expected = ODD_CALIBRATIONS[kind]
    change_calibrations(folder, "Tr_velo_to_cam", values)
    found = texts(look(folder), folder)
    assert any(expected in text for text in found), found


def test_a_picture_of_another_size_than_its_camera_is_warned_of(folder: Path) -> None:
    (folder / "training" / "image_2").mkdir(exist_ok=True)
    Image.new("RGB", (3000, 2000)).save(folder / "training" / "image_2" / "000000.png")
    found = texts(look(folder), folder)
    assert any(
        "the picture has 3000 x 2000 pixels, but P2's middle is at" in text for text in found
    )
    assert any("no picture, while 1 frames have one" in text for text in found)


def test_nothing_to_learn_names_the_classes_that_are_there(folder: Path) -> None:
    n = len([row for row in label_rows(folder, TRAIN) if row[0] == "Car"])
    change_labels(folder, with_field(0, "Truck", only="Car"))
    learn, count = look(folder).errors
    assert (
        "VoxelNet has nothing to learn: in 6 training frames no label of class Car" in learn.message
    )
    trucks = len([row for row in label_rows(folder, TRAIN) if row[0] == "Truck"])
    assert f"Truck {trucks}" in learn.advice
    assert trucks >= n > 0
    assert count.message.startswith(
        "nothing counts in split val: no label is of a class that counts. Found: "
    )
    assert "Truck" in count.message


def test_empty_labels_are_nothing_to_learn_and_nothing_that_counts(folder: Path) -> None:
    change_labels(folder, lambda row: [])
    first, second = look(folder).errors
    assert first.advice == "All 6 label files are empty."
    assert second.message == ("nothing counts in split val: the labels of 4 frames hold no object")


def test_cars_without_a_point_tell_how_many_the_fullest_holds(folder: Path) -> None:
    change_labels(folder, with_field(12, "-30.00"))
    (error,) = look(folder).errors
    assert "the fullest of those looked at holds 0 points" in error.advice


@pytest.mark.parametrize("words", [[], ["detector=pointrcnn"], ["+sweep=gamma", "seeds=2"]])
def test_a_check_of_nothing_says_what_to_give_and_simulates_nothing(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["check", *words])
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("usage: python -m fl3d check")
    assert "Name the folder that holds training/ and ImageSets/" in err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_may_be_named_by_data_root(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = ["--picture", str(tmp_path / "frame.png")]
    main(["check", "data=kitti", f"data.root={folder}", *picture])
    assert "evaluated (val): 4 frames" in capsys.readouterr().out


def test_a_class_in_another_case_is_listed_among_those_found(folder: Path) -> None:
    change_labels(folder, lambda row: ["Lorry" if row[0] == "Car" else row[0], *row[1:]])
    n = sum(row[0] == "Lorry" for row in label_rows(folder, VAL))
    words = ["classes=[lorry]", "+protocol.overlaps.lorry=[0.5,0.5,0.5]"]
    messages = [error.message for error in look(folder, *words).errors]
    (message,) = [one for one in messages if one.startswith("nothing counts")]
    assert "Did you mean 'Lorry'? Found: " in message
    assert f"Lorry {n}" in message
    assert message.endswith("possible: lorry")


def test_labels_without_2d_boxes_count_for_nobody_and_the_way_out_is_named(folder: Path) -> None:
    change_labels(folder, lambda row: [*row[:4], "0", "0", "0", "0", *row[8:]])
    (error,) = look(folder).errors
    assert "without a 2D box" in error.message
    assert "protocol lidar" in error.message
    assert look(folder, "protocol=lidar").errors == []


def test_points_that_no_detector_sees_are_an_error(folder: Path) -> None:
    change_clouds(folder, shifted)
    messages = [error.message for error in look(folder).errors]
    assert any(message.startswith("VoxelNet sees no point: of ") for message in messages)


def test_what_cannot_be_read_is_told_once_with_the_number_of_files(folder: Path) -> None:
    for name in ("000001", "000002"):
        (folder / "training" / "velodyne" / f"{name}.bin").unlink()
    (folder / "training" / "calib" / "000003.txt").write_text("P2: 1 2 3\n")
    found = texts(look(folder), folder)
    assert "error: training/velodyne/000001.bin and 1 more: no such file" in found
    assert sum("calib/000003.txt" in text for text in found) == 1


def test_a_frame_that_is_learnt_from_and_evaluated_is_warned_of(simulated: Path) -> None:
    config = compose_config(["data=kitti"])
    splits = {"train": TRAIN, "val": [*VAL, TRAIN[0]]}
    facts = gather(
        KittiFolder(simulated), splits, wanted_by([config]), read_settings(config).protocol, None
    )
    assert any(
        "1 frames are in train and in val, such as 000000" in finding.message
        for finding in checked(facts, "train", "val").findings
    )


def test_a_split_that_is_learnt_from_and_evaluated_is_warned_of(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = "".join(f"{name}\n" for name in TRAIN)
    (folder / "ImageSets" / "everything.txt").write_text(names)
    picture = ["--picture", str(tmp_path / "frame.png")]
    for words in (
        ["data.val_split=train"],
        ["data.train_split=everything", "data.val_split=everything"],
    ):
        main(["check", str(folder), *words, *picture])
        name = words[0].partition("=")[2]
        assert (
            f"warning: ImageSets/{name}.txt: all 6 frames of {name} are learnt from and evaluated"
            in capsys.readouterr().out
        )
    (folder / "ImageSets" / "val.txt").unlink()  # one split alone is no overlap
    with pytest.raises(SystemExit):
        main(["check", str(folder), *picture])
    assert "learnt from and evaluated" not in capsys.readouterr().out


def test_2d_detections_of_other_frames_are_warned_of_where_they_are_needed(folder: Path) -> None:
    for file in (folder / "rgb_detections").iterdir():
        file.write_text(file.read_text().replace("/00000", "/90000"))
    assert look(folder).findings == ()
    found = texts(look(folder, "detector=fconvnet"), folder)
    assert any("of the 6 frames of split train" in text for text in found)


def test_clouds_are_chosen_evenly_and_always_the_same() -> None:
    ids = [str(k) for k in range(11)]
    assert some_of(ids, 3) == ["0", "5", "10"]
    assert some_of(ids, 11) == some_of(ids, None) == ids


def test_a_detector_that_says_nothing_of_its_targets_wants_nothing() -> None:
    config = compose_config([])
    section = dict(config["detector"], targets=None, range_velo=None)
    assert wanted_by([dict(config, detector=section)]) == ()


def test_alike_detectors_share_a_part_of_the_line(folder: Path) -> None:
    configs = [compose_config(["data=kitti", f"detector={name}"]) for name in ("voxelnet", "fcn3d")]
    wanted = wanted_by(configs)
    same = tuple(replace(one, min_points=1, range_velo=None) for one in wanted)
    facts = gather(
        KittiFolder(folder), {"train": TRAIN}, same, read_settings(configs[0]).protocol, None
    )
    assert checked(facts, "train", "train").lines[0].endswith("are targets of VoxelNet, 3D-FCN")


def test_the_command_writes_a_picture_and_json_and_ends_with_2_where_there_is_an_error(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "frame.png"
    main(["check", str(folder), "--picture", str(picture), "--json", str(tmp_path / "found.json")])
    assert "Nothing odd was found." in capsys.readouterr().out
    with Image.open(picture) as image:
        assert image.size[0] > 1000
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["findings"] == []
    assert found["targets"]["train"]["VoxelNet"] > 0
    change_labels(folder, lambda row: [])
    with pytest.raises(SystemExit) as ended:
        main(["check", str(folder), "--picture", str(picture), "--json"])
    assert ended.value.code == 2
    found = json.loads(capsys.readouterr().out)
    assert [one["severity"] for one in found["findings"]] == [Severity.ERROR, Severity.ERROR]


def test_an_empty_split_is_an_error(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "ImageSets" / "train.txt").write_text("\n")
    with pytest.raises(SystemExit) as ended:
        main(["check", str(folder), "--picture", str(tmp_path / "frame.png")])
    assert ended.value.code == 2
    assert "error: ImageSets/train.txt: names no frame" in capsys.readouterr().out


def test_pictures_of_another_kind_are_warned_of(folder: Path) -> None:
    (folder / "training" / "image_2").mkdir(exist_ok=True)
    (folder / "training" / "image_2" / f"{TRAIN[0]}.png").unlink(missing_ok=True)
    (folder / "training" / "image_2" / f"{TRAIN[0]}.bmp").touch()
    found = texts(look(folder), folder)
    assert any(f"training/image_2/{TRAIN[0]}.bmp: is not read" in text for text in found), found


def test_labels_that_cannot_be_read_are_not_called_empty(folder: Path) -> None:
    for file in (folder / "training" / "label_2").iterdir():
        file.write_text("Car,0,0\n")
    result = look(folder)
    assert len(result.errors) == 1
    assert "KITTI separates them by blanks" in result.errors[0].message


def test_a_folder_without_splits_is_looked_at_whole(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(folder / "ImageSets")
    with pytest.raises(SystemExit):
        main(["check", str(folder), "--picture", str(tmp_path / "frame.png")])
    out = capsys.readouterr().out
    assert "learnt from (all): 10 frames" in out
    assert "error: ImageSets/train.txt" in out


@pytest.mark.parametrize(
    ("name", "hint"), [("training", "give the folder above it"), ("", "no folder 'training'")]
)
def test_a_folder_of_another_kind_is_refused(tmp_path: Path, name: str, hint: str) -> None:
    (tmp_path / "odd" / name).mkdir(parents=True)
    with pytest.raises(SystemExit, match=hint):
        main(["check", str(tmp_path / "odd" / name)])


def test_wanted_of_frustum_convnet_needs_2d_detections() -> None:
    (wanted,) = wanted_by([compose_config(["detector=fconvnet"])])
    assert wanted == Wanted("F-ConvNet", ("Car",), 1, None, True)


# What a check says of the odd inputs that are about clouds, calibrations, pictures and splits.
ODD_INPUTS = {
    "calib-4x4": "",
    "calib-identity": "the camera's axes are not x right, y down, z forward",
    "calib-tracking-names": "",
    "calib-zeros": "Tr_velo_to_cam is no rotation",
    "cloud-5-columns": "data.cloud.columns=5",
    "cloud-float64": "data.cloud.dtype=float64",
    "cloud-npy-named-bin": "",
    "image-jpg-1920": "warning: training/label_2/000001.txt: 2D boxes and projected 3D boxes",
    "labels-nuscenes": "occlusion beyond KITTI's 3",
    "split-duplicates": "ImageSets/train.txt:2",
    "train-all-labels-empty": "label files are empty",
    "train-lower-case-car": "",
}


@pytest.mark.parametrize("name", ODD_INPUTS)
def test_odd_inputs_are_read_or_named(
    odd_inputs: Path, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["check", str(odd_inputs / name), "--picture", str(tmp_path / "frame.png")]
    is_learnt_from = not ODD_INPUTS[name] or ODD_INPUTS[name].startswith("warning: ")
    if is_learnt_from:
        main(words)
    else:
        with pytest.raises(SystemExit):
            main(words)
    out = capsys.readouterr().out
    assert (ODD_INPUTS[name] or "Nothing odd was found.") in out
    if is_learnt_from:
        assert "of 9 labels of class Car, 4 are targets of VoxelNet" in out


def test_an_area_ahead_is_warned_of_where_all_around_is_kept(folder: Path) -> None:
    found = look(folder, "profile=tiny", "data.crop=none", "protocol=lidar").findings
    assert any("objects beyond x 0 to 38.4" in finding.message for finding in found)
    assert look(folder, "profile=tiny").findings == ()


def test_without_calibrations_the_way_out_is_named(folder: Path) -> None:
    shutil.rmtree(folder / "training" / "calib")
    (unreadable,) = [one for one in look(folder).errors if "no such folder" in one.message]
    assert "data.calibration=axes data.crop=none" in unreadable.message
    assert unreadable.files == 10


def test_a_picture_that_is_cut_off_is_named_and_the_rest_is_drawn(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "training" / "image_2").mkdir(exist_ok=True)
    for frame_id in TRAIN:
        file = folder / "training" / "image_2" / f"{frame_id}.png"
        noise = np.random.default_rng(0).integers(0, 255, (375, 1242, 3)).astype(np.uint8)
        Image.fromarray(noise).save(file)
        file.write_bytes(file.read_bytes()[:5000])
    main(["check", str(folder), "--picture", str(tmp_path / "frame.png")])
    assert "is a broken picture" in capsys.readouterr().err
    assert (tmp_path / "frame.png").exists()


def test_one_detector_that_learns_from_several_sets_of_classes_has_the_targets_of_each(
    simulated: Path,
) -> None:
    """They were those of the last."""
    overrides = "classes=[Car]", "classes=[Pedestrian]", "min_points=100"
    configs = [compose_config([f"detector.targets.{own}"]) for own in overrides]
    kitti = KittiFolder(simulated)
    splits = {"train": kitti.split("train"), "val": kitti.split("val")}
    protocol = read_settings(configs[0]).protocol
    together = gather(kitti, splits, wanted_by(configs), protocol, None)
    every = [together.targets("train", one) for one in together.wanted]
    for config, found in zip(configs, every, strict=True):
        alone = gather(kitti, splits, wanted_by([config]), protocol, None)
        assert alone.targets("train", alone.wanted[0]) == found
    assert len(set(every)) == 3
    told = as_json(together, checked(together, "train", "val"))["targets"]["train"]
    assert list(told.values()) == every


def test_a_rare_class_is_looked_for_beyond_the_chosen_clouds(folder: Path) -> None:
    config = compose_config(["data=kitti"])
    protocol = read_settings(config).protocol
    kitti, wanted = KittiFolder(folder), wanted_by([config])
    whole = gather(kitti, {"train": TRAIN, "val": VAL}, wanted, protocol, None)
    (holder,) = [i for i in TRAIN if whole.clouds[i].targets[wanted[0]].any()][1:2]
    for frame_id in TRAIN:
        if frame_id != holder:  # its cars are trucks now
            file = folder / "training" / "label_2" / f"{frame_id}.txt"
            file.write_text(file.read_text().replace("Car ", "Truck "))
    chosen = next(i for i in TRAIN if i != holder)
    ids = [chosen, *(i for i in TRAIN if i != chosen)]
    facts = gather(kitti, {"train": ids, "val": VAL}, wanted, protocol, 1)
    assert set(facts.clouds) - set(VAL) == {chosen, holder}
    assert checked(facts, "train", "val").errors == []


def test_clouds_are_read_once_however_often_objects_are_counted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = compose_config(["data=kitti", "protocol=lidar", "protocol.difficulty=points"])
    read: list[str] = []
    original = KittiFolder.read_cloud

    def counting(self: KittiFolder, frame_id: str) -> object:
        read.append(frame_id)
        return original(self, frame_id)

    monkeypatch.setattr(KittiFolder, "read_cloud", counting)
    facts = gather(
        KittiFolder(folder), {"train": TRAIN, "val": VAL}, (), read_settings(config).protocol, 0
    )
    assert checked(facts, "train", "val").errors == []
    assert sorted(read) == VAL
