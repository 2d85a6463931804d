"""What every detector must do, run over every YAML in conf/detector."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fl3d.config.compose import CONF, compose_config
from fl3d.data.kitti import Frame, KittiFolder
from fl3d.detectors.base import Detector, WindowDetector
from fl3d.detectors.flops import layer_flops
from fl3d.inference.load import build_detector
from fl3d.sweep.plan import configure_stage

NAMES = sorted(
    {path.stem for path in (CONF / "detector").glob("*.yaml")}
    - {"command", "imported"}  # no networks
    - {"voxelnet_people"}  # VoxelNet on another grid, see test_classes
)

DETERMINISTIC = {  # class: why its training samples are the same whatever the seed
    "FCN3D": "its input is which voxels are occupied, and all its targets are kept",
    "HeightMap": "of docs/new_detector.md: the highest point of each cell, and all its targets",
}


def networks() -> list[tuple[str, str]]:
    """Each detector in each stage that makes another network of it."""
    found: list[tuple[str, str]] = []
    for name in NAMES:
        config = compose_config([f"detector={name}", "profile=quick"])
        seen = []
        for stage in config["schedule"]["stages"]:
            own = configure_stage(config, stage)["detector"]
            if own not in seen:
                seen.append(own)
                found.append((name, stage))
    return found


@pytest.fixture(params=networks(), ids="-".join)
def detector(request: pytest.FixtureRequest) -> Detector:
    torch.manual_seed(0)
    name, stage = request.param
    return build_detector(
        configure_stage(compose_config([f"detector={name}", "profile=quick"]), stage)
    )


@pytest.fixture(scope="module")
def frames(simulated: Path) -> list[Frame]:
    folder = KittiFolder(simulated)
    return [folder.frame(i) for i in folder.split("train")[:2]]


def encode(
    detector: Detector, frames: list[Frame], training: bool = True, seed: int = 0
) -> dict[str, torch.Tensor]:
    samples = [
        detector.encode(f, np.random.default_rng([seed, i]), training) for i, f in enumerate(frames)
    ]
    return detector.collate(samples)


def without_points(frame: Frame) -> Frame:
    return replace(frame, points_velo=frame.points_velo[:0])


def without_cars(frame: Frame) -> Frame:
    labels = frame.labels.select(frame.labels.types != "Car")
    return replace(frame, labels=labels)


def test_it_names_itself_and_its_stages(detector: Detector) -> None:
    assert detector.NAME
    assert detector.STAGES
    assert detector.VERSION >= 1


def test_its_loss_is_finite_and_reaches_every_weight(
    detector: Detector, frames: list[Frame]
) -> None:
    terms = detector.loss(encode(detector, frames))
    torch.stack(list(terms.values())).sum().backward()
    for name, parameter in detector.named_parameters():
        if not parameter.requires_grad:  # of a stage before
            continue
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name


def test_a_few_steps_lower_its_loss(detector: Detector, frames: list[Frame]) -> None:
    batch = encode(detector, frames)
    optimizer = torch.optim.Adam([p for p in detector.parameters() if p.requires_grad], lr=2e-3)
    losses = []
    for _ in range(16):  # the first eight of VoxelNet's are rough: they hang on the last digits
        total = torch.stack(list(detector.loss(batch).values())).sum()
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        losses.append(float(total.detach()))
    assert losses[-1] < 0.8 * losses[0]


def test_it_finds_boxes_in_falling_order_and_no_more_than_asked(
    detector: Detector, frames: list[Frame]
) -> None:
    batch = encode(detector, frames, training=False)
    found, every = (detector.eval().detect(batch, max_boxes=n, min_score=0.0) for n in (7, 100_000))
    assert len(found) == 2
    for one, among in zip(found, every, strict=True):
        assert one.boxes_velo.shape == (min(7, len(among.scores)), 7)
        assert len(among.scores) > 0
        np.testing.assert_allclose(one.scores, among.scores[:7], rtol=1e-12)
        assert np.isfinite(one.boxes_velo).all()
        assert (np.diff(one.scores) <= 0).all()
        assert (one.scores >= 0).all()
        assert (one.scores <= 1).all()


def test_the_score_floor_holds(detector: Detector, frames: list[Frame]) -> None:
    batch = encode(detector, frames, training=False)
    detector.eval()
    scores = detector.detect(batch, max_boxes=10_000, min_score=0.0)[0].scores
    floor = float(np.median(scores))
    assert len(detector.detect(batch, 10_000, floor)[0].scores) == int((scores >= floor).sum())


def test_a_frame_without_points_and_one_without_cars_are_survived(
    detector: Detector, frames: list[Frame]
) -> None:
    batch = encode(detector, [without_points(frames[0]), without_cars(frames[1])])
    terms = detector.loss(batch)  # none where there is nothing to learn
    assert all(torch.isfinite(term) for term in terms.values())
    found = detector.eval().detect(
        encode(detector, [without_points(frames[0])], training=False), 5, 0.0
    )
    assert np.isfinite(found[0].boxes_velo).all()


def test_frames_of_a_batch_do_not_mix(detector: Detector, frames: list[Frame]) -> None:
    """In evaluation mode a frame gives the same boxes alone and in company."""
    detector.eval()
    together = detector.detect(encode(detector, frames, training=False), 20, 0.0)
    alone = detector.detect(encode(detector, frames[:1], training=False), 20, 0.0)
    np.testing.assert_allclose(together[0].scores, alone[0].scores, atol=1e-5)


def test_same_randomness_same_sample(detector: Detector, frames: list[Frame]) -> None:
    first, second, other = (encode(detector, frames, seed=seed) for seed in (1, 1, 2))
    assert all(
        torch.equal(first[key], second[key])
        for key in first
        if isinstance(first[key], torch.Tensor)
    )
    assert set(first) == set(other)


def test_other_randomness_other_sample_unless_the_detector_is_listed_as_drawing_nothing(
    detector: Detector, frames: list[Frame]
) -> None:
    first = encode(detector, frames, seed=1)
    other = encode(detector, frames, seed=2)
    tensors = [key for key in first if isinstance(first[key], torch.Tensor)]
    differ = [key for key in tensors if not torch.equal(first[key], other[key])]
    name = type(detector).__name__
    if name in DETERMINISTIC:
        assert not differ, f"{name} draws {differ}, so take it off DETERMINISTIC"
    else:
        assert differ, f"{name} draws nothing; if that is meant, say why in DETERMINISTIC"


def test_its_work_is_known_without_computing(detector: Detector) -> None:
    name = NAMES[[n.lower() for n in NAMES].index(type(detector).__name__.lower())]
    for profile in ("quick", "paper"):
        config = compose_config([f"detector={name}", f"profile={profile}"])
        flops = layer_flops(lambda config=config: build_detector(config))
        assert all(count > 0 for count in flops.values())


def test_boxes_and_positives_of_one_pass_are_those_of_two(
    detector: Detector, frames: list[Frame]
) -> None:
    """To the bit, and a sample with targets holds what one without holds."""
    if not isinstance(detector, WindowDetector):
        pytest.skip("its samples with targets are others, or its boxes are of no windows")
    detector.eval()
    plain, whole = (encode(detector, frames, training=on) for on in (False, True))
    for key in set(plain) - {"layout"}:
        assert torch.equal(plain[key], whole[key]), key
    found, positives = detector.detect_with_positives(whole, 50, 0.0)
    assert len(positives) > 0
    with torch.no_grad():  # with gradients some layers are computed another way
        assert torch.equal(positives, detector.windows(whole)[0])
    for one, alone in zip(found, detector.detect(plain, 50, 0.0), strict=True):
        np.testing.assert_array_equal(one.boxes_velo, alone.boxes_velo)
        np.testing.assert_array_equal(one.scores, alone.scores)
