"""VoxelNet's anchors, codes and features."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.anchors import Anchors, decode_boxes, encode_boxes
from fl3d.detectors.runs_of_rows import beside_largest, largest
from fl3d.detectors.voxel_nets import FeatureNet
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.geometry.boxes import rectangles_velo, standup
from fl3d.geometry.iou import bev_iou, image_iou
from fl3d.inference.load import build_detector

PLAIN = {
    "range_velo": (0.0, -4.0, -3.0, 8.0, 4.0, 1.0),
    "shape": (20, 20),
    "size": (1.56, 1.6, 3.9),
    "z": -1.78,
    "grid": "centers",
    "positive": 0.6,
    "negative": 0.45,
    "iou": "standup",
    "iou_plus_one": False,
}


def test_anchors_stand_at_cell_centres_in_two_headings() -> None:
    boxes = Anchors(**PLAIN).boxes_velo
    assert boxes.shape == (800, 7)
    np.testing.assert_allclose(boxes[0], [0.2, -3.8, -1.78, 1.56, 1.6, 3.9, 0])
    np.testing.assert_allclose(boxes[1, 6], np.pi / 2)
    np.testing.assert_allclose(boxes[2, :2], [0.6, -3.8])


def test_the_codes_grid_runs_from_border_to_border() -> None:
    boxes = Anchors(**PLAIN | {"grid": "linspace"}).boxes_velo
    assert boxes[:, 0].min() == 0
    assert boxes[:, 0].max() == 8


def test_matching_by_hand() -> None:
    """A car on an anchor: shifted by d along its length the overlap is (3.9 - d) / (3.9 + d)."""
    matcher = Anchors(**PLAIN | {"positive": 0.62})  # one row aside the overlap is 0.6
    anchors = matcher.boxes_velo
    car = anchors[anchors[:, 6] == 0][210:211]
    chosen, owner, negative = matcher.assign(car)
    assert set(owner) == {0}
    beside = np.abs(anchors[:, 1] - car[0, 1]) < 0.01
    along = np.abs(anchors[:, 0] - car[0, 0])
    overlap = (3.9 - along) / (3.9 + along)
    straight = beside & (anchors[:, 6] == 0)
    assert set(np.flatnonzero(straight & (overlap > 0.62))) == set(chosen)
    assert negative[straight & (overlap < 0.45)].all()
    between = straight & (overlap >= 0.45) & (overlap <= 0.62)
    assert between.any()
    assert not negative[between].any()


def test_a_car_too_far_from_every_anchor_gets_its_best() -> None:
    matcher = Anchors(**PLAIN)
    car = np.array([[4.0, 0.0, -1.78, 1.5, 1.0, 2.0, 0.0]])  # overlap at most 2 / 6.24
    chosen, _, negative = matcher.assign(car)
    assert len(chosen) == 1
    assert not negative[chosen].any()


def test_a_frame_without_cars_is_all_negative() -> None:
    matcher = Anchors(**PLAIN)
    chosen, owner, negative = matcher.assign(np.zeros((0, 7)))
    assert len(chosen) == len(owner) == 0
    assert negative.all()


def test_the_codes_extra_metre_widens_the_match() -> None:
    plain, wide = Anchors(**PLAIN), Anchors(**PLAIN | {"iou_plus_one": True})
    anchors = plain.boxes_velo
    car = anchors[400:401] + np.array([0.1, 0.1, 0, 0, 0, 0, 0])
    assert len(wide.assign(car)[0]) > len(plain.assign(car)[0])


@pytest.mark.parametrize("change", [{}, {"iou_plus_one": True}, {"iou": "rotated"}])
def test_matching_is_what_all_pairs_say(change: dict[str, object]) -> None:
    matcher, rng = Anchors(**PLAIN | change), np.random.default_rng(0)
    anchors = rectangles_velo(matcher.boxes_velo)
    grow = np.array([0, 0, 1, 1]) if "iou_plus_one" in change else np.zeros(4)
    for count in (1, 3, 8):
        low, high = [-1.0, -5, -1.8, 1.4, 1.4, 3.0, -2], [9.0, 5, -1.6, 1.7, 1.9, 5.0, 2]
        cars = rng.uniform(low, high, size=(count, 7))
        cars[0] = matcher.boxes_velo[0] + 0.0  # exactly on an anchor
        b = rectangles_velo(cars)
        overlap = (
            bev_iou(anchors, b)
            if "iou" in change
            else image_iou(standup(anchors) + grow, standup(b) + grow)
        )
        positive = overlap.max(axis=1) > 0.6
        positive[overlap.argmax(axis=0)[overlap.max(axis=0) > 0]] = True
        chosen, owner, negative = matcher.assign(cars)
        np.testing.assert_array_equal(chosen, np.flatnonzero(positive))
        np.testing.assert_array_equal(negative, ~positive & (overlap.max(axis=1) < 0.45))
        best = set(overlap.argmax(axis=0))
        usual = ~np.isin(chosen, list(best))
        np.testing.assert_array_equal(owner[usual], overlap[chosen[usual]].argmax(axis=1))


def test_misspellings_are_named() -> None:
    with pytest.raises(ConfigError, match=r"detector\.anchors\.grid.*centers, linspace"):
        Anchors(**PLAIN | {"grid": "center"})


sizes = st.floats(0.5, 6)


@given(st.floats(-40, 40), sizes, sizes, sizes, st.floats(-3, 3))
def test_codes_lead_back_to_their_box(
    x: float, h: float, w: float, length: float, yaw: float
) -> None:
    box = np.array([[x, 1.0, -1.5, h, w, length, yaw]])
    anchor = np.array([[x + 1, 0.0, -1.78, 1.56, 1.6, 3.9, 0.0]])
    np.testing.assert_allclose(decode_boxes(encode_boxes(box, anchor), anchor), box, atol=1e-9)


def test_codes_are_the_published_ones() -> None:
    """Zhou and Tuzel, Eq. 1, over the diagonal sqrt(l^2 + w^2)."""
    anchor = np.array([[10.0, 0.0, -1.78, 1.56, 1.6, 3.9, 0.0]])
    box = np.array([[11.0, 2.0, -1.0, 1.56 * np.e, 1.6, 3.9, 0.2]])
    diagonal = np.hypot(1.6, 3.9)
    expected = [[1 / diagonal, 2 / diagonal, 0.78 / 1.56, 1, 0, 0, 0.2]]
    np.testing.assert_allclose(encode_boxes(box, anchor), expected)


def test_the_voxel_maximum_is_over_its_own_points() -> None:
    rows = torch.tensor([[1.0, 5.0], [3.0, 2.0], [-1.0, -2.0]])
    assert largest(rows, torch.tensor([2, 1])).tolist() == [[3, 5], [-1, -2]]


@pytest.mark.parametrize("way", ["alone", "beside"])
def test_maxima_and_their_gradients_are_those_of_torch(way: str) -> None:
    torch.manual_seed(0)
    lengths = torch.tensor([3, 1, 7, 2])
    rows = torch.randn(13, 5, dtype=torch.float64).round(decimals=1)
    rows[6] = rows[5]  # the same point twice
    ours, theirs = rows.clone().requires_grad_(), rows.clone().requires_grad_()
    maxima = torch.segment_reduce(theirs, "max", lengths=lengths, axis=0)
    if way == "alone":
        found, expected = largest(ours, lengths), maxima
    else:
        found = beside_largest(ours, lengths)
        expected = torch.cat([theirs, maxima.repeat_interleave(lengths, dim=0)], dim=1)
    assert torch.equal(found, expected)
    grad = torch.randn_like(expected)
    found.backward(grad)
    expected.backward(grad)
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-14, atol=1e-14)


def test_the_order_of_points_in_a_voxel_does_not_matter() -> None:
    torch.manual_seed(0)
    network = FeatureNet((16, 16), 16).eval()
    rows = torch.randn(5, 7)
    lengths = torch.tensor([3, 2])
    swapped = rows[[2, 0, 1, 4, 3]]
    torch.testing.assert_close(network(rows, lengths, None), network(swapped, lengths, None))


def test_padding_as_in_the_code_is_an_option(simulated: Path) -> None:
    """mask_max=false: every voxel has T rows, and those beyond its points are zero."""
    config = compose_config(["detector=voxelnet", "profile=quick", "detector.mask_max=false"])
    detector = build_detector(config)
    assert isinstance(detector, VoxelNet)
    folder = KittiFolder(simulated)
    frame = folder.frame(folder.split("train")[0])
    sample = detector.encode(frame, np.random.default_rng(0), training=True)
    assert (sample["lengths"] == 35).all()
    assert len(sample["rows"]) == 35 * len(sample["cells"])
    assert (sample["rows"][sample["mask"][:, 0] == 0] == 0).all()
    assert torch.isfinite(
        torch.stack(list(detector.loss(detector.collate([sample])).values()))
    ).all()


def test_offsets_are_from_the_mean_of_the_voxels_points(simulated: Path) -> None:
    detector = build_detector(compose_config(["detector=voxelnet", "profile=quick"]))
    folder = KittiFolder(simulated)
    sample = detector.encode(
        folder.frame(folder.split("train")[0]), np.random.default_rng(0), training=False
    )
    first = sample["rows"][: sample["lengths"][0]]
    np.testing.assert_allclose(first[:, 4:], first[:, :3] - first[:, :3].mean(axis=0), atol=1e-4)
    assert sample["lengths"].max() <= 35


def test_kernels_of_the_papers_text_look_along_z_alone() -> None:
    """A ninth of the weights; what differs in one column changes that column of the map alone."""
    cube, column = (
        build_detector(compose_config(["detector=voxelnet", "profile=tiny", *words]))
        for words in ([], ["detector.middle_kernel=column"])
    )
    assert isinstance(cube, VoxelNet)
    assert isinstance(column, VoxelNet)
    weights = [
        sum(p.numel() for p in one.middle.parameters() if p.dim() == 5) for one in (cube, column)
    ]
    assert weights[0] == 9 * weights[1]
    middle = column.middle.eval()
    x = torch.zeros(1, next(middle.parameters()).shape[1], *cube.grid.shape)
    y = x.clone()
    y[..., 3, 4] = 1
    out = (middle(y) - middle(x)).abs().sum(dim=(0, 1, 2))
    assert out.shape == x.shape[-2:]
    assert torch.nonzero(out).tolist() == [[3, 4]]


def test_a_kernel_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match=r"detector\.middle_kernel: no kernel 'cub'.*'cube'"):
        build_detector(compose_config(["detector=voxelnet", "detector.middle_kernel=cub"]))
