"""Augmentation: what moves moves together, and objects that are pasted in stand on the road and apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import ConfigError, DataError
from fl3d.data.augment import Augmentation, ObjectSampling
from fl3d.data.dataset import Frames
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.road import fit_road, read_plane, road_height
from fl3d.geometry.boxes import count_points_inside, rectangles_velo
from fl3d.geometry.iou import bev_iou

RANGE = (0.0, -40.0, -3.0, 70.4, 40.0, 1.0)
OBJECTS = ObjectSampling(["Car"], (10, 15), 100, 0.6, 100, 5, 0.5, RANGE, "fitted")


@pytest.fixture(scope="module")
def frames(simulated: Path) -> Frames:
    folder = KittiFolder(simulated)
    return Frames(folder, folder.split("train"), cache=10)


def cars(frame: Frame) -> np.ndarray:
    return frame.calibration.boxes_to_velo(frame.labels.boxes_cam[frame.labels.types == "Car"])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_nothing_asked_nothing_changed(frames: Frames) -> None:
    found = Augmentation(0.0, 0.0, 0.0)(frames, 0, rng())
    np.testing.assert_array_equal(found.points_velo, frames[0].points_velo)
    np.testing.assert_allclose(found.labels.boxes_cam, frames[0].labels.boxes_cam, atol=1e-9)


@pytest.mark.parametrize(
    "change", [Augmentation(1.0, 0, 0), Augmentation(0, 45, 0), Augmentation(0, 0, 0.2)]
)
def test_points_stay_in_their_boxes(frames: Frames, change: Augmentation) -> None:
    for index in range(3):
        before, after = frames[index], change(frames, index, rng(index))
        assert not np.array_equal(before.points_velo, after.points_velo)
        counted = count_points_inside(before.points_velo, cars(before))
        again = count_points_inside(after.points_velo, cars(after))
        np.testing.assert_allclose(again, counted, atol=2)  # on a border rounding decides


def test_a_flip_by_hand(frames: Frames) -> None:
    after = Augmentation(1.0, 0.0, 0.0)(frames, 0, rng())
    np.testing.assert_allclose(cars(after)[:, 1], -cars(frames[0])[:, 1], atol=1e-9)
    np.testing.assert_allclose(np.sin(cars(after)[:, 6]), -np.sin(cars(frames[0])[:, 6]), atol=1e-9)


def test_objects_put_in_hold_their_points_stand_apart_and_on_the_road(frames: Frames) -> None:
    change, added = Augmentation(0.0, 0.0, 0.0, OBJECTS), 0
    for index in range(3):
        before, after = frames[index], change(frames, index, rng(index))
        n = len(before.labels)
        assert (after.labels.types[:n] == before.labels.types).all()
        boxes = after.calibration.boxes_to_velo(
            after.labels.boxes_cam[after.labels.types != "DontCare"]
        )
        new = after.calibration.boxes_to_velo(after.labels.boxes_cam[n:])
        added += len(new)
        assert (count_points_inside(after.points_velo, new) >= OBJECTS.min_points - 1).all()
        overlaps = bev_iou(rectangles_velo(new), rectangles_velo(boxes))
        assert (overlaps.sum(axis=1) < 1 + 1e-6).all()  # each with itself alone
        height = road_height(before, frames.folder, "fitted")
        np.testing.assert_allclose(new[:, 2], [height(place) for place in new[:, :2]], atol=1e-6)
    assert added > 0


def test_same_randomness_same_frame_whatever_was_asked_before(frames: Frames) -> None:
    first = Augmentation(0.5, 10, 0.05, OBJECTS)
    first(frames, 1, rng(5))
    second = Augmentation(0.5, 10, 0.05, OBJECTS)
    a, b = first(frames, 0, rng(1)), second(frames, 0, rng(1))
    np.testing.assert_array_equal(a.points_velo, b.points_velo)
    np.testing.assert_array_equal(a.labels.boxes_cam, b.labels.boxes_cam)


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        (Augmentation(0.5, 0, 0), 2),  # flipped or not
        (Augmentation(0, 10, 0), 8),
        (Augmentation(0, 0, 0.05), 8),
        (Augmentation(0, 0, 0, OBJECTS), 8),
    ],
    ids=["flip", "turn", "scale", "objects"],
)
def test_other_randomness_other_frame(frames: Frames, change: Augmentation, outcomes: int) -> None:
    """Each change alone, under eight seeds: as many different points and boxes as it can make."""
    changed = [change(frames, 0, rng(seed)) for seed in range(8)]
    assert len({frame.points_velo.tobytes() for frame in changed}) == outcomes
    assert len({frame.labels.boxes_cam.tobytes() for frame in changed}) == outcomes


def test_the_road_is_found_below_clutter() -> None:
    r = rng()
    ground = np.column_stack([r.uniform(0, 70, 3000), r.uniform(-30, 30, 3000), np.zeros(3000)])
    ground[:, 2] = 0.01 * ground[:, 0] - 0.005 * ground[:, 1] - 1.7 + r.normal(0, 0.02, 3000)
    clutter = np.column_stack(
        [r.uniform(0, 70, 1500), r.uniform(-30, 30, 1500), r.uniform(-1.4, 2, 1500)]
    )
    found = fit_road(np.concatenate([ground, clutter]))
    assert np.abs(found - [0.01, -0.005, -1.7])[:2].max() < 0.002
    assert abs(found[2] + 1.7) < 0.05
    assert fit_road(np.zeros((0, 3)))[2] == -1.7


def test_the_road_is_read_from_a_plane(frames: Frames, tmp_path: Path) -> None:
    frame = frames[0]
    (tmp_path / "training" / "planes").mkdir(parents=True)
    path = tmp_path / "training" / "planes" / f"{frame.id}.txt"
    path.write_text("# Plane\nWidth 4\nHeight 1\n0.0 -1.0 0.0 1.65\n")
    height = road_height(frame, KittiFolder(tmp_path), "planes")
    for place in ((10.0, 3.0), (40.0, -8.0)):
        on_road = frame.calibration.points_to_cam(np.array([[*place, height(np.array(place))]]))
        assert abs(on_road[0, 1] - 1.65) < 1e-9
    path.write_text("1 2 3\n")
    with pytest.raises(DataError, match=r"a plane needs four numbers.*found 3"):
        read_plane(path)
    with pytest.raises(DataError, match="no such file"):
        road_height(replace(frame, id="999999"), KittiFolder(tmp_path), "planes")


def test_an_unknown_road_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"augment.objects.road: no choice 'sea'"):
        replace(OBJECTS, road="sea")


def test_objects_outside_the_range_and_with_few_points_are_not_taken(frames: Frames) -> None:
    every = [one for i in range(len(frames)) for one in OBJECTS.objects(frames[i])]
    assert every
    near = replace(OBJECTS, range_velo=(0.0, -40.0, -3.0, 15.0, 40.0, 1.0))
    kept = [one for i in range(len(frames)) for one in near.objects(frames[i])]
    assert len(kept) == sum(one.box_velo[0] < 15 for one in every)
    full = replace(OBJECTS, min_points=200)
    assert all(
        len(one.points_velo) >= 200 for i in range(len(frames)) for one in full.objects(frames[i])
    )
