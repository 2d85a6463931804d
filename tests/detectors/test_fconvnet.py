"""Frustum ConvNet by hand: rays, slabs, labels, the box code, and boxes that come back to the LiDAR's frame."""

from dataclasses import replace
from math import pi, radians
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_stage_settings
from fl3d.core.errors import ConfigError, DataError
from fl3d.data.dataset import Frames
from fl3d.data.image_boxes import read_image_boxes
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.data.projection import project_boxes
from fl3d.detectors.base import Found
from fl3d.detectors.fconvnet import FConvNet
from fl3d.detectors.frustum_net import FrustumNet
from fl3d.detectors.frustum_samples import BoxView, FrustumView, Jitter
from fl3d.detectors.frustums import (
    enlarged,
    jittered,
    label_places,
    moved,
    rays,
    sampled,
    suppressed,
    turned,
)
from fl3d.detectors.multibin import MultiBin, corner_distance
from fl3d.detectors.regions import centered, turned_back
from fl3d.evaluation.protocol import Protocol
from fl3d.geometry.boxes import points_inside
from fl3d.geometry.iou import bev_and_3d_iou_velo
from fl3d.inference.detect import detect_frames
from fl3d.inference.load import build_detector
from fl3d.inference.predict import detect_labels
from fl3d.points.slabs import SlabNet, Slabs, resolutions

SIZES = ((1.5, 1.6, 3.9), (1.8, 0.7, 0.8), (1.7, 0.6, 1.8))
CARS = torch.zeros(60, dtype=torch.int64)  # the first size class
CODE = MultiBin(SIZES, 12, {"yaw_bin": 1.0, "yaw": 20.0, "size": 20.0, "corner": 10.0})


@pytest.fixture(scope="module")
def frame(simulated: Path) -> Frame:
    folder = KittiFolder(simulated)
    return max(
        (folder.frame(i) for i in folder.split("train")),
        key=lambda f: int((f.labels.types == "Car").sum()),
    )


@pytest.fixture
def detector() -> FConvNet:
    torch.manual_seed(0)
    config = compose_config(["detector=fconvnet", "profile=quick"])
    config["detector"]["refine"] = None
    detector = build_detector(config)
    assert isinstance(detector, FConvNet)
    return detector


def perfect(boxes: torch.Tensor) -> torch.Tensor:
    """Outputs that say exactly these boxes."""
    outputs = torch.zeros(len(boxes), CODE.width)
    step = 2 * pi / 12
    shifted = torch.remainder(boxes[:, 6] + step / 2, 2 * pi) / step
    chosen, rows = shifted.floor().long(), torch.arange(len(boxes))
    outputs[:, :3] = boxes[:, :3]
    outputs[rows, 3 + chosen] = 50.0
    outputs[rows, 15 + chosen] = 2 * (shifted - chosen - 0.5)
    outputs[:, 27] = 50.0
    outputs[:, 30:33] = boxes[:, 3:6] / torch.tensor(SIZES[0]) - 1
    return outputs


def some_boxes(n: int = 60) -> torch.Tensor:
    rng = np.random.default_rng(0)
    columns = [rng.normal(0, 1, (n, 3)), rng.uniform(1, 4, (n, 3)), rng.uniform(-pi, pi, (n, 1))]
    return torch.from_numpy(np.concatenate(columns, axis=1).astype(np.float32))


def test_the_code_has_39_numbers_as_the_paper() -> None:
    assert CODE.width == 39


def test_boxes_come_back_from_their_code_and_perfect_outputs_lose_nothing() -> None:
    boxes = some_boxes()
    torch.testing.assert_close(CODE.decode(perfect(boxes)), boxes, rtol=1e-4, atol=1e-4)
    assert sum(float(term) for term in CODE.loss(perfect(boxes), boxes, CARS).values()) < 1e-3
    assert sum(float(term) for term in CODE.loss(perfect(boxes), boxes.flip(0), CARS).values()) > 5
    assert (
        sum(float(term) for term in CODE.loss(perfect(boxes)[:0], boxes[:0], CARS[:0]).values())
        == 0
    )


def test_weights_act_on_their_terms() -> None:
    boxes, wrong = some_boxes(), perfect(some_boxes().flip(0))
    heavier = MultiBin(SIZES, 12, {"yaw_bin": 1.5, "yaw": 30.0, "size": 20.0, "corner": 10.0})
    plain, other = CODE.loss(wrong, boxes, CARS), heavier.loss(wrong, boxes, CARS)
    torch.testing.assert_close(other["reg_yaw"], 1.5 * plain["reg_yaw"])
    for name in ("reg_center", "reg_size", "reg_corner"):
        assert other[name] == plain[name]


def test_corners_do_not_tell_front_from_back() -> None:
    boxes = some_boxes()
    back = boxes + torch.tensor([0, 0, 0, 0, 0, 0, pi])
    assert corner_distance(boxes, back).max() < 1e-4
    away = boxes + torch.tensor([3.0, 4.0, 0, 0, 0, 0, 0])
    torch.testing.assert_close(corner_distance(boxes, away), torch.full((len(boxes),), 5.0))


def test_a_ray_passes_through_its_pixel(frame: Frame) -> None:
    pixels = np.array([[600.0, 180.0], [100.0, 200.0], [1200.0, 300.0]])
    origin, directions = rays(frame.calibration, pixels)
    for distance in (5.0, 40.0):
        seen, _ = frame.calibration.points_to_image(
            frame.calibration.points_to_cam(origin + distance * directions)
        )
        np.testing.assert_allclose(seen, pixels, atol=1e-6)


def test_slabs_hold_what_lies_near_their_places() -> None:
    slabs = Slabs(1.0, 0.5, 4, [8])
    np.testing.assert_allclose(slabs.depths(0.0, 3.0), [0.5, 1.5, 2.5])
    net = SlabNet(slabs).eval()
    points = torch.tensor([[[0.4, 1.0, 0.0], [0.6, 0.0, 1.0], [2.9, 0.0, 0.0]]])
    places = torch.tensor([[[0.5, 0, 0], [1.5, 0, 0], [2.5, 0, 0]]])
    found = net(points, places)
    assert found.shape == (1, 3, 8)
    assert (found[0, 1] == 0).all()
    expected = net.mlp(torch.tensor([[-0.1, 1.0, 0.0], [0.1, 0.0, 1.0]])).amax(dim=0)
    torch.testing.assert_close(found[0, 0], expected)


def test_resolutions_are_read_from_columns() -> None:
    found = resolutions({"stride": [1, 2], "half": [1, 3], "samples": [4, 5], "widths": [[8], [9]]})
    assert found == [Slabs(1, 1, 4, [8]), Slabs(2, 3, 5, [9])]
    with pytest.raises(ValueError, match="shorter"):
        resolutions({"stride": [1, 2], "half": [1], "samples": [4, 5], "widths": [[8], [9]]})


def test_places_are_labelled_by_shares_of_the_object() -> None:
    box = torch.tensor([[10.0, 0.0, -1.0, 2.0, 2.0, 4.0, 0.0]])  # centre at height 0
    places = torch.tensor([[[10.0, 0, 0], [11.1, 0, 0], [12.1, 0, 0], [10, 0.6, 0], [10, 0, 0.49]]])
    assert label_places(places, box, (0.5, 1.0)).tolist() == [[1, -1, 0, -1, 1]]
    far = places + torch.tensor([0.0, 20.0, 0.0])
    assert label_places(far, box, (0.5, 1.0)).tolist() == [[1, 0, 0, 0, 0]]  # the nearest stands in


def test_boxes_come_back_from_their_frustum() -> None:
    rng = np.random.default_rng(0)
    boxes = np.column_stack(
        [rng.normal(0, 5, (20, 3)), rng.uniform(1, 4, (20, 3)), rng.uniform(-3, 3, 20)]
    )
    origin, angle = np.array([0.3, -0.1, -0.05]), 0.4
    inside = centered(torch.from_numpy(moved(boxes, -origin, -angle)))
    turn, places = (
        torch.full((20,), angle, dtype=torch.float64),
        torch.from_numpy(np.tile(origin, (20, 1))),
    )
    back = turned_back(inside, turn, places).numpy()
    np.testing.assert_allclose(back[:, :6], boxes[:, :6], atol=1e-9)
    np.testing.assert_allclose(np.sin(back[:, 6]), np.sin(boxes[:, 6]), atol=1e-9)


def test_jitter_and_sampling_and_enlarging_by_hand() -> None:
    rng = np.random.default_rng(0)
    boxes = np.tile([100.0, 100.0, 200.0, 150.0], (500, 1))
    moved_boxes = jittered(boxes, 0.1, 0.1, rng)
    extent = moved_boxes[:, 2:] - moved_boxes[:, :2]
    assert (np.abs(extent / [100, 50] - 1) <= 0.1).all()
    assert np.abs((moved_boxes[:, 0] + moved_boxes[:, 2]) / 2 - 150).max() <= 10
    points = np.arange(9.0).reshape(3, 3)
    assert len(sampled(points, 5, rng)) == 5
    assert {tuple(row) for row in sampled(points, 3, rng)} == {tuple(row) for row in points}
    np.testing.assert_allclose(
        enlarged(np.array([[0, 0, -1, 2, 1, 4, 0.3]]), 1.2), [[0, 0, -1.2, 2.4, 1.2, 4.8, 0.3]]
    )


def test_samples_turn_and_grow_with_their_objects() -> None:
    """What lies at a corner of the object stays there."""
    still = Jitter(shift=0, size=0, yaw=0, depth=0, most=0, flip=0, turn=0, scale=0)
    box = np.array([20.0, 1.0, -1.0, 1.5, 1.6, 4.0, 0.4])
    corner = turned(np.array([[2.0, 0.8, 0.0]]), 0.4) + box[:3]
    same = still.changed(corner, box, np.random.default_rng(0))
    assert (same[0] == corner).all()
    assert (same[1] == box).all()
    for rule in (
        replace(still, turn=30.0),
        replace(still, scale=0.2),
        replace(still, flip=1.0, turn=30.0, scale=0.2),
    ):
        points, changed = rule.changed(corner, box, np.random.default_rng(0))
        assert np.abs(changed - box).max() > 0.01
        factor = changed[5] / box[5]
        side = -1 if rule.flip else 1
        own = turned(points - changed[:3], -changed[6])
        np.testing.assert_allclose(own, factor * np.array([[2.0, side * 0.8, 0.0]]), atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(changed[:3]), factor * np.linalg.norm(box[:3]))


def frustum_nets_that_say_their_axis(detector: FConvNet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small boxes in the middle of each 2D box, 20 m away; the second stage leaves them where they are."""
    rng = np.random.default_rng(5)

    def find(
        network: FrustumNet, points: torch.Tensor, slope: torch.Tensor, kinds: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        boxes = torch.tensor([[0.0, 0, 0, 0.5, 0.1, 0.1, 0]]).repeat(len(points), 1)
        if network is detector.frustum:
            boxes[:, 0], boxes[:, 2] = 20.0, 20.0 * slope
        return (
            boxes,
            torch.from_numpy(rng.uniform(0.1, 0.9, len(points))),
            torch.arange(len(points)),
        )

    monkeypatch.setattr(detector, "_find", find)
    if detector.refine is None:
        return
    count = detector.second_view.points

    def look(points_velo: np.ndarray, boxes_velo: np.ndarray) -> tuple[np.ndarray, list[int]]:
        kept = list(range(1, len(boxes_velo), 2))  # every second box holds points
        return np.zeros((len(kept), count, 3), np.float32), kept

    monkeypatch.setattr(detector, "second_view", SimpleNamespace(look=look))


@pytest.mark.parametrize("stages", [1, 2])
@pytest.mark.parametrize("batch_size", [1, 3])
def test_each_box_brings_the_2d_box_it_came_of(
    simulated: Path, monkeypatch: pytest.MonkeyPatch, stages: int, batch_size: int
) -> None:
    config = compose_config(["detector=fconvnet", "profile=quick"])
    if stages == 1:
        config["detector"]["refine"] = None
    detector = build_detector(config).eval()
    assert isinstance(detector, FConvNet)
    frustum_nets_that_say_their_axis(detector, monkeypatch)
    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("val"), 10)
    rng = np.random.default_rng(2)
    drawn_on: list[Frame] = []
    for index in range(
        len(frames)
    ):  # six boxes of different sizes about points of each frame; none in the second
        one = frames[index]
        chosen = rng.choice(
            one.points_velo[one.points_velo[:, 0] > 5, :3].astype(float), 0 if index == 1 else 6
        )
        pixels, _ = one.calibration.points_to_image(one.calibration.points_to_cam(chosen))
        half = rng.uniform(20, 40, pixels.shape)
        drawn = np.column_stack([pixels - half, pixels + half, rng.uniform(0.1, 0.9, len(half))])
        drawn_on.append(replace(one, image_boxes=drawn, image_types=None))
    monkeypatch.setattr(Frames, "__getitem__", lambda _, index: drawn_on[index])
    found = detect_frames(detector, frames, 300, 0.0, batch_size=batch_size)
    assert len(found.of(1)[0]) == 0
    assert len(found.scores) >= 9
    for index, frame_id in enumerate(found.frame_ids):
        boxes, scores, images, _ = found.of(index)
        assert images is not None
        assert (np.diff(scores) <= 0).all()
        calibration = folder.read_calibration(frame_id)
        middles = calibration.points_to_cam(boxes[:, :3] + np.array([[0, 0, 0.25]]))
        seen, _ = calibration.points_to_image(middles)
        np.testing.assert_allclose(seen, (images[:, :2] + images[:, 2:]) / 2, atol=0.05)


def test_a_prediction_has_the_2d_detectors_boxes(simulated: Path, frame: Frame) -> None:
    torch.manual_seed(0)
    config = compose_config(["detector=fconvnet", "profile=quick"])
    seen, protocol = (
        KittiFolder(simulated).frame(frame.id),
        Protocol(**{**config["protocol"], "score_threshold": 0.0}),
    )
    labels = detect_labels(
        build_detector(config).eval(), seen, protocol, read_stage_settings(config)
    )
    assert seen.image_boxes is not None
    clipped = np.clip(seen.image_boxes[:, :4], 0, np.array([seen.image_size] * 2).ravel() - 1.0)
    assert len(labels) > 0
    assert all((np.abs(clipped - box).max(axis=1) < 1e-3).any() for box in labels.boxes_image)


def test_between_the_stages_boxes_are_suppressed_in_3d() -> None:
    boxes = np.array(
        [
            [20.0, 0, -1.7, 1.5, 1.6, 4, 0],
            [20.0, 0, -0.1, 1.5, 1.6, 4, 0],
            [20.2, 0, -1.7, 1.5, 1.6, 4, 0],
        ]
    )
    kept = suppressed(Found(boxes, np.array([0.9, 0.8, 0.7]), np.arange(12.0).reshape(3, 4)), 9)
    assert kept.scores.tolist() == [0.9, 0.8]
    assert kept.boxes_image is not None
    assert kept.boxes_image[:, 0].tolist() == [0, 4]


@pytest.mark.parametrize("stage", ["frustum", "refine"])
def test_a_samples_points_move_with_its_object(frame: Frame, stage: str) -> None:
    """Flipped, turned, scaled and shifted, each point lies in its object's frame where it lies in the cloud."""
    still = Jitter(shift=0, size=0, yaw=0, depth=0, most=0, flip=0, turn=0, scale=0)
    rule = replace(still, depth=0.3, most=0.4, flip=1.0, turn=4.0, scale=0.1)
    is_car = frame.labels.types == "Car"
    cars = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[is_car])
    held = points_inside(frame.points_velo, cars).sum(axis=1)
    own, image = cars[[held.argmax()]], frame.labels.boxes_image[is_car][[held.argmax()]]

    def sample(jitter: Jitter) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(1)
        if stage == "frustum":
            found = FrustumView((0.0, 70.0), 2.0, 64, jitter).learn(
                frame, image, own, np.zeros(1, np.int64), rng
            )
        else:
            found = BoxView(1.2, 2.0, 64, jitter).learn(frame, own, np.zeros(1, np.int64), rng)
        return found["points"][0].astype(float), found["boxes"][0].astype(float)

    cloud = turned(frame.points_velo[:, :3].astype(float) - own[0, :3], -own[0, 6])
    plain, (points, box) = sample(still)[1], sample(rule)
    assert np.abs(plain - box)[[0, 6]].min() > 1e-3
    factor = box[5] / own[0, 5]
    assert abs(factor - 1) > 1e-3
    seen = turned(points - box[:3], -box[6]) / factor * [1, -1, 1]  # flipped
    nearest = np.linalg.norm(cloud[:, None] - seen[None], axis=2).min(axis=0)
    assert nearest.max() < 2e-4


def test_training_frustums_hold_their_objects(detector: FConvNet, frame: Frame) -> None:
    """The label, taken back from its frustum, is one of the frame's cars, and its place is labelled positive."""
    detector.view.jitter = replace(detector.view.jitter, flip=0.0)
    sample = detector.encode(frame, np.random.default_rng(0), training=True)
    assert len(sample["points"]) > 0
    places = detector.frustum.places(torch.from_numpy(sample["slope"]), 1)
    labels = label_places(places, torch.from_numpy(sample["boxes"]), (0.5, 1.0))
    assert (labels == 1).any(dim=1).all()
    middle = places[labels == 1].numpy()
    assert np.isfinite(middle).all()
    inside = np.abs(sample["points"][..., 1]).max()
    assert inside < 60  # points lie about the axis
    cars = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[frame.labels.types == "Car"])
    for box, angle in zip(sample["boxes"], sample["angle"], strict=True):
        sizes = np.abs(cars[:, 3:6] - box[3:6]).max(axis=1)
        turns = np.abs(np.sin(cars[:, 6] - angle - box[6]))
        assert ((sizes < 1e-4) & (turns < 1e-4)).any()


def test_two_stages_find_what_perfect_networks_would(
    simulated: Path, frame: Frame, detector: FConvNet
) -> None:
    """With the 2D boxes of the labels and outputs that say the truth, every car comes back where it is."""
    detector.view.reach = detector.frustum.reach = (0.0, 70.0)
    cars = frame.labels.types == "Car"
    boxes_velo = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[cars])
    _, clipped, visible = project_boxes(boxes_velo, frame.calibration, frame.image_size)
    assert visible.all()
    seen = Frame(
        frame.id, frame.points_velo, frame.calibration, frame.labels, frame.image_size,
        np.column_stack([clipped, np.full(len(clipped), 0.9)]),
    )  # fmt: skip
    sample = detector.encode(seen, np.random.default_rng(0), training=False)
    batch = detector.collate([sample])
    angle, origin = sample["angle"], sample["origin"]
    assert len(angle) == len(boxes_velo)  # every car holds points
    shifted = zip(boxes_velo[:, None], origin, angle, strict=True)
    targets = np.concatenate([moved(box, -o.astype(float), -float(a)) for box, o, a in shifted])

    class Truth(torch.nn.Module):
        slabs, reach, places = (
            detector.frustum.slabs,
            detector.frustum.reach,
            detector.frustum.places,
        )

        def forward(
            self, points: torch.Tensor, slope: torch.Tensor, kinds: torch.Tensor
        ) -> tuple[torch.Tensor, torch.Tensor]:
            spots = Truth.places(slope, 1)
            boxes = centered(torch.from_numpy(targets).float())
            relative = boxes[:, None].expand(-1, spots.shape[1], -1).clone()
            relative[..., :3] -= spots
            codes = perfect(relative.flatten(0, 1)).view(*spots.shape[:2], -1)
            logits = torch.full(spots.shape[:2], -9.0)
            logits[:, 0] = 9.0
            return logits, codes

    detector.code = CODE
    truth = Truth()
    found = detector._find(truth, batch["points"], batch["slope"], batch["kinds"])  # type: ignore[arg-type]
    back = (
        turned_back(found[0], batch["angle"][found[2]], batch["origin"][found[2]])
        .numpy()
        .astype(float)
    )
    overlaps = bev_and_3d_iou_velo(boxes_velo, back)[1]
    assert overlaps.max(axis=1).min() > 0.98


def test_2d_boxes_are_read_by_frame_and_class(tmp_path: Path) -> None:
    assert read_image_boxes(tmp_path, "Car") is None
    folder = tmp_path / "rgb_detections"
    folder.mkdir()
    file = folder / "rgb_detection_val.txt"
    file.write_text(
        "a/b/000001.png 2 0.5 1 2 3 4\n\nx/000001.png 1 0.4 0 0 1 1\n/000002.png 2 0.25 -4 0 9 9.5\n"
    )
    found = read_image_boxes(tmp_path, "Car")
    assert found is not None
    assert found["000001"].tolist() == [[1, 2, 3, 4, 0.5]]
    assert found["000002"].tolist() == [[-4, 0, 9, 9.5, 0.25]]
    people = read_image_boxes(tmp_path, "Pedestrian")
    assert people is not None
    assert list(people) == ["000001"]


@pytest.mark.parametrize(
    ("line", "message"),
    [("000001.png 2 0.5 1 2 3", "a box needs"), ("000001.png 9 0.5 1 2 3 4", "a class \\(1, 2, 3 or"),
     ("000001.png 12 0.5 1 2 3 4", "a class \\(1, 2, 3 or"), ("000001.png 2 1.5 1 2 3 4", "score in 0..1"),
     ("000001.png 2 0.5 3 2 1 4", "x1 y1 before"), ("000001.png 2 0.5 1 2 3 x", r"field 'y2': 'x' is not a number")],
)  # fmt: skip
def test_a_line_that_is_no_2d_box_is_named(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / "rgb_detections").mkdir()
    (tmp_path / "rgb_detections" / "rgb_detection_train.txt").write_text(
        "000000.png 2 0.5 1 2 3 4\n" + line + "\n"
    )
    with pytest.raises(DataError, match=rf"rgb_detection_train.txt:2: .*{message}"):
        read_image_boxes(tmp_path, "Car")


def test_without_2d_boxes_it_says_what_is_missing(detector: FConvNet, frame: Frame) -> None:
    bare = Frame(frame.id, frame.points_velo, frame.calibration, frame.labels, frame.image_size)
    detector.encode(bare, np.random.default_rng(0), training=True)  # which needs labels alone
    with pytest.raises(DataError, match="needs 2D boxes"):
        detector.encode(bare, np.random.default_rng(0), training=False)


def test_yaw_bins_by_hand() -> None:
    boxes = some_boxes(3)
    boxes[:, 6] = torch.tensor([0.0, radians(20), radians(-100)])
    assert perfect(boxes)[:, 3:15].argmax(dim=1).tolist() == [0, 1, 9]


def test_the_second_stages_sample_has_its_object_at_the_middle_and_across(frame: Frame) -> None:
    config = compose_config(["detector=fconvnet", "profile=quick"])
    config["detector"]["refine"]["jitter"] = dict.fromkeys(
        config["detector"]["refine"]["jitter"], 0.0
    )
    detector = build_detector(config)
    assert isinstance(detector, FConvNet)
    sample = detector.encode(frame, np.random.default_rng(0), training=True)
    assert len(sample["points"]) > 0
    np.testing.assert_allclose(sample["boxes"][:, :2], 0, atol=1e-5)
    np.testing.assert_allclose(sample["boxes"][:, 6], -pi / 2, atol=1e-5)
    half = (
        sample["boxes"][:, None, [4, 5]] / 2 * 1.2 + 1e-4
    )  # width along the axis, length beside it
    assert (np.abs(sample["points"][..., :2]) <= half).all()
    places = detector.refine.places(torch.zeros(len(sample["points"])), 1)  # type: ignore[union-attr]
    assert (
        (label_places(places, torch.from_numpy(sample["boxes"]), (0.3, 0.6)) == 1).any(dim=1).all()
    )


def test_cars_beyond_the_frustum_are_not_learnt(detector: FConvNet, frame: Frame) -> None:
    detector.view.reach = (0.0, 15.0)
    detector.view.jitter = replace(detector.view.jitter, flip=0.0, depth=0.0)
    sample = detector.encode(frame, np.random.default_rng(0), training=True)
    assert (sample["boxes"][:, 0] < 15.0).all()


def network_that_sees(used: list[int] | None) -> FrustumNet:
    torch.manual_seed(0)
    slabs = [Slabs(0.5 * 2**n, 0.5 * 2**n, 4, (4, 8)) for n in range(4)]
    return FrustumNet(slabs, (0.0, 16.0), (8, 8, 8, 8), 8, CODE, used)


def test_a_resolution_that_is_not_used_says_nothing_and_learns_nothing() -> None:
    points = torch.rand(2, 40, 3, generator=torch.Generator().manual_seed(1)) * 16
    kinds = torch.zeros(2, dtype=torch.int64)
    every, listed, some = (network_that_sees(used) for used in (None, [3, 0, 1, 2], [1, 2]))
    given = points, torch.zeros(2), kinds
    assert torch.equal(every(*given)[0], listed(*given)[0])
    logits = some(*given)[0]
    assert logits.shape == every(*given)[0].shape
    assert not torch.equal(logits, every(*given)[0])
    logits.sum().backward()  # type: ignore[no-untyped-call]
    learns = [any(p.grad is not None for p in net.parameters()) for net in some.points]
    assert learns == [False, True, True, False]


@pytest.mark.parametrize("used", [[], [4], [1, -1]])
def test_resolutions_that_are_not_there_are_refused(used: list[int]) -> None:
    with pytest.raises(ConfigError, match=r"detector\.slabs_used: .* resolutions 0 to 3"):
        network_that_sees(used)
