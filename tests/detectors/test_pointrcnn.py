"""PointRCNN by hand: the box code, what is proposed, drawn and pooled."""

from math import pi, radians

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.detectors.bins import BinCode
from fl3d.detectors.pointrcnn import PointRCNN
from fl3d.detectors.regions import from_regions, pool, relative_to_regions
from fl3d.detectors.rois import ProposalRule, RoiRule, jitter
from fl3d.geometry.boxes import NEAR, NONE, owners
from fl3d.geometry.iou import bev_and_3d_iou_velo
from fl3d.inference.load import build_detector

SIZE = (1.5, 1.6, 3.9)
RULE = RoiRule(32, 0.5, 0.55, 0.45, 0.05, 0.8, 0.6, 0.55, 10)


def code(
    search: float = 3.0, length: float = 0.5, yaw_bins: int = 12, yaw_range: float = 2 * pi
) -> BinCode:
    return BinCode(search, length, yaw_bins, yaw_range, SIZE)


def perfect(own: BinCode, boxes: torch.Tensor) -> torch.Tensor:
    """Outputs that say exactly these boxes."""
    outputs = torch.zeros(len(boxes), own.width)
    x, y, rx, ry, z, yaw, ryaw, size = own._split(outputs)
    bins, residuals = own._place_targets(boxes[:, :2])
    turn, turn_residual = own._yaw_targets(boxes[:, 6])
    rows = torch.arange(len(boxes))
    for scores, values, axis in ((x, rx, 0), (y, ry, 1)):
        scores[rows, bins[:, axis]] = 50.0
        values[rows, bins[:, axis]] = residuals[:, axis]
    yaw[rows, turn] = 50.0
    ryaw[rows, turn] = turn_residual
    z[:, 0] = boxes[:, 2]
    mean = torch.tensor(SIZE)
    size[:] = (boxes[:, 3:6] - mean) / mean
    return outputs


def some_boxes(seed: int, n: int, reach: float, turn: float) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    columns = [
        rng.uniform(-reach, reach, (n, 2)),
        rng.normal(size=(n, 1)),
        rng.uniform(1, 4, (n, 3)),
    ]
    return torch.from_numpy(
        np.column_stack([*columns, rng.uniform(-turn, turn, n)]).astype(np.float32)
    )


@pytest.mark.parametrize(
    ("own", "width"),
    [
        (code(), 76),
        (code(2.0, 0.2), 108),
        (code(1.5, 0.5, 9, pi / 2), 46),
        (code(1.5, 0.3, 9, pi / 2), 62),
    ],
)
def test_the_code_is_as_wide_as_the_report_says(own: BinCode, width: int) -> None:
    assert own.width == width


@pytest.mark.parametrize("own", [code(), code(2.0, 0.2), code(1.5, 0.3, 9, pi / 2)])
def test_a_box_comes_back_from_its_code(own: BinCode) -> None:
    turn = own.yaw_range / 2 - 0.01
    boxes = some_boxes(0, 200, own.search - 0.01, turn)
    torch.testing.assert_close(own.decode(perfect(own, boxes)), boxes, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("own", [code(), code(1.5, 0.3, 9, pi / 2)])
def test_perfect_outputs_lose_nothing_and_others_do(own: BinCode) -> None:
    boxes = some_boxes(1, 50, own.search - 0.01, own.yaw_range / 2 - 0.01)
    outputs = perfect(own, boxes)
    assert sum(float(term) for term in own.loss(outputs, boxes).values()) < 1e-3
    assert sum(float(term) for term in own.loss(outputs, boxes.flip(0)).values()) > 1
    assert sum(float(term) for term in own.loss(outputs[:0], boxes[:0]).values()) == 0


def test_bins_by_hand() -> None:
    own = code()
    bins, residuals = own._place_targets(torch.tensor([[-3.0, 0.0], [0.6, 99.0]]))
    assert bins.tolist() == [[0, 6], [7, 11]]
    np.testing.assert_allclose(residuals, [[-0.5, -0.5], [-0.3, 0.498]], atol=1e-4)
    turn, rest = own._yaw_targets(torch.tensor([0.0, radians(20), radians(-30)]))
    assert turn.tolist() == [0, 1, 11]
    np.testing.assert_allclose(rest, [0, -10 / 15, 0], atol=1e-5)


def test_opposite_headings_are_one_in_the_second_stage() -> None:
    own = code(1.5, 0.5, 9, pi / 2)
    for degrees in (0, 12, -44, 30):
        there, back = (
            own._yaw_targets(torch.tensor([radians(d)])) for d in (degrees, degrees + 180)
        )
        assert there[0] == back[0]
        torch.testing.assert_close(there[1], back[1], rtol=0, atol=1e-4)
    assert own._yaw_targets(torch.tensor([0.0]))[0] == 4


def test_bins_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"bins of 4.0 m"):
        code(3.0, 4.0)


def test_points_know_their_box() -> None:
    box = np.array([[10.0, 0.0, -1.0, 2.0, 2.0, 4.0, 0.0]])
    points = np.array(
        [[10, 0, 0], [12.1, 0, 0], [12.3, 0, 0], [10, 1.1, 0], [10, 0, 1.15], [8.1, -0.9, -0.9]]
    )
    assert owners(points, box, 0.2).tolist() == [0, NEAR, NONE, NEAR, NEAR, 0]
    turned = box + [0, 0, 0, 0, 0, 0, pi / 2]
    assert owners(points[:2], turned, 0.0).tolist() == [0, NONE]


def test_proposals_share_the_depths() -> None:
    rule = ProposalRule(0.8, 10, 20, [(0, 40, 0.7), (40, 80, 0.3)])
    x = np.concatenate([np.arange(30) + 5.0, np.arange(30) + 41.0])
    boxes = np.column_stack([x, np.zeros(60), np.zeros(60), np.tile([1.5, 1.6, 3.9, 0.0], (60, 1))])
    boxes[:, 1] = np.arange(60) * 10  # far apart
    scores = np.concatenate([np.linspace(1, 2, 30), np.linspace(3, 4, 30)])
    chosen = rule.choose(boxes, scores)
    assert (x[chosen] <= 40).sum() == 7
    assert (x[chosen] > 40).sum() == 3
    assert (np.diff(scores[chosen]) <= 0).all()
    same = np.zeros_like(boxes) + boxes[:1]
    assert len(rule.choose(same, scores)) == 1


def test_regions_for_training_are_half_foreground_at_most() -> None:
    rng = np.random.default_rng(0)
    objects = np.array([[10.0, 0, -1, 1.5, 1.6, 3.9, 0.3], [20.0, 5, -1, 1.5, 1.6, 3.9, 1.0]])
    near = objects[rng.integers(2, size=40)] + rng.normal(0, 0.05, (40, 7))
    far = near + [0, 9, 0, 0, 0, 0, 0]
    regions, targets, overlaps = RULE.draw(np.concatenate([near, far]), objects, rng)
    assert regions.shape == targets.shape == (32, 7)
    paired = np.diagonal(bev_and_3d_iou_velo(regions, targets)[1])
    np.testing.assert_allclose(overlaps, paired)
    assert (overlaps >= 0.55).sum() <= 16
    assert (overlaps[:16] >= 0.55).mean() > 0.9  # ten jitters find one


def test_regions_where_nothing_is_and_where_nothing_is_proposed() -> None:
    rng = np.random.default_rng(0)
    boxes = np.tile([[10.0, 0, -1, 1.5, 1.6, 3.9, 0.0]], (5, 1))
    regions, _, overlaps = RULE.draw(boxes, np.zeros((0, 7)), rng)
    assert len(regions) == 32
    assert (overlaps == 0).all()
    assert len(RULE.draw(np.zeros((0, 7)), boxes, rng)[0]) == 0


def test_jitter_stays_within_its_strengths() -> None:
    boxes = np.tile([[10.0, 0, -1, 1.5, 1.6, 3.9, 0.0]], (4000, 1))
    moved = jitter(boxes, np.random.default_rng(0))
    assert np.abs(moved[:, :3] - boxes[:, :3]).max() <= 1.0
    assert np.abs(moved[:, 3:6] / boxes[:, 3:6] - 1).max() <= 0.15
    assert np.abs(moved[:, 6]).max() <= radians(60)
    assert 0.17 < (moved == boxes).all(axis=1).mean() < 0.23


def test_boxes_come_back_from_regions() -> None:
    rng = np.random.default_rng(0)
    boxes, regions = (torch.from_numpy(rng.normal(5, 2, (30, 7))) for _ in range(2))
    back = from_regions(relative_to_regions(boxes, regions), regions)
    torch.testing.assert_close(back, boxes)


def test_pooled_points_stand_in_the_regions_frame() -> None:
    points = torch.tensor([[[10.0, 0.0, 0.0], [10.0, 2.5, 0.0], [50.0, 0.0, 0.0]]])
    features = torch.tensor([[[1.0], [2.0], [3.0]]])
    region = torch.tensor([[10.0, 0.0, -1.0, 2.0, 2.0, 4.0, pi / 2], [80.0, 0, 0, 1, 1, 1, 0]])
    rows, held = pool(points, features, region, torch.tensor([0, 0]), extra=1.0, count=3)
    assert held.tolist() == [True, False]
    torch.testing.assert_close(
        rows[0], torch.tensor([[0.0, 0, 0, 1], [2.5, 0, 0, 2], [0.0, 0, 0, 1]]), rtol=0, atol=1e-5
    )
    assert (rows[1] == 0).all()


def test_the_second_stage_leaves_the_first_alone() -> None:
    detector = build_detector(compose_config(["detector=pointrcnn", "profile=quick"]))
    assert isinstance(detector, PointRCNN)
    detector.train()
    assert detector.rcnn is not None
    assert detector.rcnn.training
    assert not any(module.training for module in detector.rpn.modules())
    assert not any(parameter.requires_grad for parameter in detector.rpn.parameters())


def test_an_unknown_classification_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"detector.rcnn.classification: no choice 'hinge'"):
        build_detector(compose_config(["detector=pointrcnn", "detector.rcnn.classification=hinge"]))
