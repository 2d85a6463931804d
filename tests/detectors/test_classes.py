"""Any class, and several: what every detector in conf/detector must do with classes other than cars."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fl3d.config.compose import CONF, compose_config
from fl3d.core.errors import ConfigError
from fl3d.data.classes import CARS
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.detectors.anchors import Anchors, ClassAnchors
from fl3d.detectors.base import Detector
from fl3d.detectors.fcn3d import FCN3D
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.inference.detect import detect_frames
from fl3d.inference.load import build_detector
from fl3d.sweep.plan import configure_stage

NAMES = sorted({path.stem for path in (CONF / "detector").glob("*.yaml")} - {"command", "imported"})
ONE_CLASS = ("pointrcnn",)
OWN = {  # what is given for a class that nobody knows
    "voxelnet": "+detector.per_class.Cone.anchors={size:[0.7,0.4,0.4],z:-1.7}",
    "voxelnet_people": "+detector.per_class.Cone.anchors={size:[0.7,0.4,0.4],z:-1.7}",
    "fconvnet": "+detector.per_class.Cone.size=[0.7,0.4,0.4]",
    "pointrcnn": "+detector.per_class.Cone.size=[0.7,0.4,0.4]",
}
Case = tuple[str, str, tuple[str, ...]]


def built(name: str, stage: str | None, classes: tuple[str, ...], *words: str) -> Detector:
    torch.manual_seed(0)
    listed = f"classes=[{','.join(classes)}]"
    config = compose_config([f"detector={name}", "profile=quick", listed, *words])
    stage = stage or next(iter(config["schedule"]["stages"]))
    return build_detector(configure_stage(config, stage))


def cases() -> list[Case]:
    """Each detector in each of its stages that is another network, of one class and of two."""
    stages = {"fconvnet": ("frustum", "refine"), "pointrcnn": ("rpn", "rcnn")}
    found = []
    for name in NAMES:
        for stage in stages.get(name, ("warmup",)):
            found.append((name, stage, ("Pedestrian",)))
            if name not in ONE_CLASS and name != "voxelnet_people":  # of two it is as voxelnet
                found.append((name, stage, ("Car", "Pedestrian")))
    return found


@pytest.fixture(params=cases(), ids=lambda case: f"{case[0]}-{case[1]}-{'+'.join(case[2])}")
def detector(request: pytest.FixtureRequest) -> Detector:
    name, stage, classes = request.param
    return built(name, stage, classes)


@pytest.fixture(scope="module")
def frames(simulated: Path) -> list[Frame]:
    """Two frames, every second of whose cars is called a pedestrian; a 2D detector has found all of them."""
    folder = KittiFolder(simulated)
    found = []
    for name in folder.split("train")[:2]:
        frame = folder.frame(name)
        types = frame.labels.types.astype("<U20")
        cars = np.flatnonzero(types == "Car")
        types[cars[1::2]] = "Pedestrian"
        labels = replace(frame.labels, types=types)
        boxes = np.column_stack([labels.boxes_image[cars], np.linspace(0.5, 0.9, len(cars))])
        found.append(replace(frame, labels=labels, image_boxes=boxes, image_types=types[cars]))
    return found


def encode(detector: Detector, frames: list[Frame], training: bool = True) -> dict[str, object]:
    samples = [
        detector.encode(frame, np.random.default_rng(i), training) for i, frame in enumerate(frames)
    ]
    return detector.collate(samples)


def test_its_loss_is_finite_and_reaches_every_weight(
    detector: Detector, frames: list[Frame]
) -> None:
    torch.stack(list(detector.loss(encode(detector, frames)).values())).sum().backward()
    for name, weight in detector.named_parameters():
        if weight.requires_grad:  # else of a stage before
            assert weight.grad is not None, name
            assert torch.isfinite(weight.grad).all(), name


def test_of_each_class_it_finds_so_many_boxes_the_best_first(
    detector: Detector, frames: list[Frame]
) -> None:
    batch = encode(detector, frames, training=False)
    few, every = (detector.eval().detect(batch, count, 0.0) for count in (7, 100_000))
    for one, among in zip(few, every, strict=True):
        assert among.kinds is not None or len(detector.classes) == 1
        own, of_all = one.types(detector.classes), among.types(detector.classes)
        assert own is not None
        assert of_all is not None
        assert set(of_all) == set(detector.classes)
        assert (np.diff(one.scores) <= 0).all()
        for name in detector.classes:
            np.testing.assert_allclose(
                one.scores[own == name], among.scores[of_all == name][:7], rtol=1e-12
            )


@pytest.mark.parametrize("name", ["voxelnet", "fcn3d", "fconvnet", "pointrcnn"])
def test_cars_are_learnt_and_found_to_the_bit_as_where_no_class_is_told(
    name: str, frames: list[Frame]
) -> None:
    """Configs from before there were classes tell none; what they train must be what classes=[Car] trains."""
    config = compose_config([f"detector={name}", "profile=quick"])
    assert config.pop("classes") == ["Car"]
    config["detector"].pop("per_class", None)
    first = configure_stage(config, next(iter(config["schedule"]["stages"])))
    torch.manual_seed(0)
    found = [
        found_and_lost(one, frames) for one in (build_detector(first), built(name, None, CARS))
    ]
    for untold, told in zip(*found, strict=True):
        assert torch.equal(untold, told)


def found_and_lost(detector: Detector, frames: list[Frame]) -> list[torch.Tensor]:
    """What it loses, the gradient of each weight, and the boxes and scores that it finds."""
    torch.manual_seed(0)
    losses = torch.stack(list(detector.loss(encode(detector, frames)).values()))
    losses.sum().backward()
    weights = [weight.grad for weight in detector.parameters() if weight.grad is not None]
    found = detector.eval().detect(encode(detector, frames, training=False), 50, 0.0)
    boxes = [torch.from_numpy(each) for one in found for each in (one.boxes_velo, one.scores)]
    return [losses.detach(), *weights, *boxes]


@pytest.mark.parametrize("name", NAMES)
def test_a_class_of_ones_own_needs_its_settings_and_no_more(name: str) -> None:
    known = [] if name not in OWN else [OWN[name]]
    if known:
        with pytest.raises(ConfigError, match=r"give \+detector\.per_class\.Cone\."):
            built(name, None, ("Cone",))
    assert built(name, None, ("Cone",), *known).classes == ("Cone",)


def test_pointrcnn_says_that_it_detects_one_class() -> None:
    with pytest.raises(ConfigError, match=r"one of classes=\[Car\] or classes=\[Cyclist\]"):
        built("pointrcnn", None, ("Car", "Cyclist"))


def test_types_that_are_learnt_must_be_those_of_the_classes() -> None:
    with pytest.raises(ConfigError, match=r"do not hold Pedestrian.*classes=\[Pedestrian\]"):
        built("voxelnet", None, ("Pedestrian",), "detector.targets.classes=[Car,Van]")
    with pytest.raises(ConfigError, match=r"Truck is none of classes=\[Car,Pedestrian\]"):
        built(
            *("voxelnet", None, ("Car", "Pedestrian")),
            "detector.targets.classes=[Car,Pedestrian,Truck]",
        )


def test_neighbours_are_learnt_as_the_class_that_they_stand_by(frames: list[Frame]) -> None:
    types = frames[0].labels.types.astype("<U20")
    cars, people = np.flatnonzero(types == "Car"), np.flatnonzero(types == "Pedestrian")
    types[cars[0]], types[people[0]] = "Van", "Person_sitting"
    frame = replace(frames[0], labels=replace(frames[0].labels, types=types))
    words = "detector.targets.classes=[Car,Van,Pedestrian,Person_sitting]"
    detector = built(
        "voxelnet", None, ("Car", "Pedestrian"), words, "detector.targets.min_points=0"
    )
    _, kinds = detector.targets.objects(frame, detector.classes)
    assert sorted(kinds) == [0] * len(cars) + [1] * len(people)


def test_each_class_has_its_own_least_number_of_points(frames: list[Frame]) -> None:
    words = "+detector.per_class.Pedestrian.min_points=100000"
    detector = built("fcn3d", None, ("Car", "Pedestrian"), words)
    assert isinstance(detector, FCN3D)
    _, kinds = detector.targets.objects(frames[0], detector.classes, detector.least)
    assert set(kinds) == {0}


def test_an_object_is_matched_with_the_anchors_of_its_class_alone() -> None:
    """At the one place stand a car's two anchors, then a pedestrian's; a pedestrian there is the third."""
    shared = {"range_velo": (0.0, 0, -3, 4, 4, 1), "shape": (1, 1), "grid": "centers"}
    rule = {"positive": 0.5, "negative": 0.35, "iou": "standup", "iou_plus_one": False}
    cars = Anchors(size=(1.5, 1.6, 3.9), z=-1.7, **shared, **rule)
    people = Anchors(size=(1.7, 0.6, 0.8), z=-1.7, **shared, **rule)
    anchors = ClassAnchors([cars, people])
    assert anchors.boxes_velo[:, 5].tolist() == [3.9, 3.9, 0.8, 0.8]
    assert anchors.kinds.tolist() == [0, 0, 1, 1]
    person = np.array([[2.0, 2, -1.7, 1.7, 0.6, 0.8, 0.0]])
    chosen, owners, negative = anchors.assign(person, np.array([1]))
    # Its own anchor shares all with it, the turned one 0.6 * 0.6 of 2 * 0.48 - 0.36: 0.6.
    assert (chosen.tolist(), owners.tolist()) == ([2, 3], [0, 0])
    assert negative.tolist() == [True, True, False, False]
    chosen, _, negative = anchors.assign(person, np.array([0]))
    assert chosen.tolist() == [0]  # which shares most of all, if little
    assert negative.tolist() == [False, True, True, True]


def test_3d_fcn_has_a_map_of_windows_for_each_class(frames: list[Frame]) -> None:
    """A pedestrian's cell lies one map further than a car's in the same place."""
    as_two = built("fcn3d", None, ("Car", "Pedestrian"))
    as_cars = built("fcn3d", None, ("Car",))
    assert isinstance(as_two, FCN3D)
    two = as_two.encode(frames[0], np.random.default_rng(0), training=True)["cells"]
    types = np.where(frames[0].labels.types == "Pedestrian", "Car", frames[0].labels.types)
    all_cars = replace(frames[0], labels=replace(frames[0].labels, types=types))
    one = as_cars.encode(all_cars, np.random.default_rng(0), training=True)["cells"]
    height = as_two.cells[0]
    assert (two[:, 0] >= height).any()
    folded = np.column_stack([two[:, 0] % height, two[:, 1:]])
    assert sorted(map(tuple, folded)) == sorted(map(tuple, one))


def test_the_papers_grid_for_people() -> None:
    """Zhou and Tuzel 2018, section 3.1: 10 x 200 x 240 voxels of at most 45 points; anchors at all 200 x 240 places."""
    config = compose_config(["detector=voxelnet_people", "profile=paper"])
    with torch.device("meta"):
        detector = build_detector(config)
    assert isinstance(detector, VoxelNet)
    assert detector.classes == ("Pedestrian",)
    assert detector.grid.shape == (10, 200, 240)
    assert detector.max_points == 45
    assert len(detector.anchors) == 200 * 240 * 2
    x, y, z, *size = detector.anchors[0, :6]
    assert size == [1.73, 0.6, 0.8]
    assert z + 1.73 / 2 == pytest.approx(-0.6)
    assert (x, y) == pytest.approx((0.1, -19.9))


def test_stored_boxes_name_their_classes_where_they_are_not_all_cars(simulated: Path) -> None:
    from fl3d.data.dataset import Frames

    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("val")[:1], 1)
    found = detect_frames(built("fcn3d", None, ("Car", "Cone")), frames, 5, 0.0)
    assert found.types is not None
    assert sorted(found.types) == ["Car"] * 5 + ["Cone"] * 5
    assert detect_frames(built("fcn3d", None, ("Car",)), frames, 5, 0.0).types is None
