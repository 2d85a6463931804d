"""What is compiled for a CPU is to the bit what PyTorch makes, which a GPU goes by."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fl3d.detectors import regions
from fl3d.detectors.regions import pool
from fl3d.points import network, operators, slabs
from fl3d.points.neighbours import limit
from fl3d.points.network import Backbone, Level, PointMLP, SetAbstraction
from fl3d.points.operators import ball_query, farthest_points, interpolate, nearest_known, plain
from fl3d.points.slabs import SlabNet, Slabs

Result = TypeVar("Result")


def by_torch(call: Callable[[], Result]) -> Result:
    """A call as any other device makes it."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (operators, slabs, regions):
            patch.setattr(module, "plain", lambda *_: None)
        for module in (operators, network):
            patch.setattr(module, "is_single", lambda *_: False)
        return call()


def clouds(seed: int, *shape: int, step: float = 0.0) -> Tensor:
    """Points of a LiDAR's kind, near ones dense; or on a lattice, so that distances tie."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=shape) * [8, 8, 0.6] * rng.random((*shape[:-1], 1))
    if step:
        points = np.round(points / step) * step
    return torch.from_numpy(points.astype(np.float32))


STEPS = st.sampled_from([0.0, 0.5, 2.0])
SIZES = st.integers(1, 90)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 300), SIZES, STEPS)
def test_farthest_points(seed: int, n_clouds: int, n_points: int, count: int, step: float) -> None:
    """More than there are, too, and of equals the first."""
    points = clouds(seed, n_clouds, n_points, 3, step=step)
    assert torch.equal(
        farthest_points(points, count), by_torch(lambda: farthest_points(points, count))
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 300), SIZES, st.floats(0.01, 9), STEPS)
def test_balls(seed: int, n_points: int, n_centers: int, radius: float, step: float) -> None:
    points, centers = (
        clouds(seed, 2, n_points, 3, step=step),
        clouds(seed + 1, 2, n_centers, 3, step=step),
    )
    radii, counts = [radius, 0.5, 2.0, 0.0], [3, 1, 40, 2]  # on a lattice many lie on the sphere
    found = ball_query(points, centers, radii, counts)
    for one, other in zip(
        found, by_torch(lambda: ball_query(points, centers, radii, counts)), strict=True
    ):
        assert torch.equal(one, other)


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.5, 0.8, 1.0, 1.6, 2.0, 4.0])
def test_the_limit_of_a_radius_parts_what_is_inside(radius: float) -> None:
    square, own = limit(radius), np.float32(radius)
    assert np.sqrt(square) >= own > np.sqrt(np.nextafter(square, np.float32(0)))


def test_nothing_is_inside_no_radius() -> None:
    assert limit(0.0) == 0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 300), SIZES, STEPS)
def test_nearest_points(seed: int, n_points: int, n_known: int, step: float) -> None:
    """Of equals the one that torch takes."""
    points, known = (
        clouds(seed, 2, n_points, 3, step=step),
        clouds(seed + 1, 2, n_known, 3, step=step),
    )
    count = min(3, n_known)
    found = nearest_known(points, known, count)
    for one, other in zip(
        found, by_torch(lambda: nearest_known(points, known, count)), strict=True
    ):
        assert torch.equal(one, other)


@pytest.mark.parametrize("n_known", [1, 40])  # one of them in so many places
def test_points_far_from_all_known_ones_and_equal_ones(n_known: int) -> None:
    known = clouds(0, 1, 40, 3)
    points = torch.cat([known + 500, known - torch.tensor([300.0, 0, 0]), known * 0], dim=1)
    some = known[:, :n_known].expand(1, 40, 3)
    found, other = nearest_known(points, some, 3), by_torch(lambda: nearest_known(points, some, 3))
    assert torch.equal(found[0], other[0])
    assert torch.equal(found[1], other[1])


def outcome(module: torch.nn.Module, call: Callable[[], Tensor]) -> list[Tensor]:
    """A result, and the gradient of a sum of it whose terms differ."""
    module.zero_grad()
    found = call()
    (found * torch.linspace(-1, 1, found.numel()).view_as(found)).sum().backward()
    return [found.detach(), *(p.grad.clone() for p in module.parameters() if p.grad is not None)]


def agree(module: torch.nn.Module, call: Callable[[], Tensor]) -> None:
    """Result and gradients are the same both ways."""
    own, other = outcome(module, call), by_torch(lambda: outcome(module, call))
    assert len(own) == len(other) > 1
    assert all(torch.equal(a, b) for a, b in zip(own, other, strict=True))


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.parametrize(
    "n_points", [12, 200]
)  # fewer than are kept: copies tie, and share gradients
def test_a_backbone(step: float, n_points: int) -> None:
    torch.manual_seed(0)
    levels = [Level(60, [0.5, 2.0], [4, 16], [[8, 16], [12]]), Level(10, [4.0], [8], [[16]])]
    backbone = Backbone(levels, [[16], [8]])
    points = clouds(1, 3, n_points, 3, step=step)
    agree(backbone, lambda: backbone(points))


@pytest.mark.parametrize("norm", [True, False])
def test_a_level_of_all_points(norm: bool) -> None:
    torch.manual_seed(0)
    level = SetAbstraction(2, Level(None, [0.0], [1], [[6, 5]]), norm)
    points = clouds(2, 4, 30, 3, step=1.0)
    agree(level, lambda: level(points, points[..., :2])[1])


def test_the_largest_of_a_group_that_nothing_passes_is_zero_and_what_is_no_number_is_told() -> None:
    mlp = PointMLP(1, [1], norm=False)
    torch.nn.init.ones_(mlp.layers[0].weight)
    torch.nn.init.zeros_(mlp.layers[0].bias)
    assert mlp(torch.tensor([[[-1.0], [-2.0]], [[3.0], [1.0]]]), grouped=True).tolist() == [
        [0.0],
        [3.0],
    ]
    assert mlp(torch.tensor([[[1.0], [torch.nan], [2.0]]]), grouped=True).isnan().all()
    groups = torch.tensor([[[2.0], [2.0], [1.0]], [[-1.0], [-2.0], [-1.0]]])
    agree(mlp, lambda: mlp(groups, grouped=True))


@pytest.mark.parametrize("step", [0.0, 0.25])
def test_slabs(step: float) -> None:
    """Points on the border of a slab, slabs without points, and points beyond all slabs."""
    torch.manual_seed(0)
    net = SlabNet(Slabs(0.5, 0.5, 6, [8, 16]))
    points = clouds(3, 5, 70, 3, step=step)
    depths = net.slabs.depths(-3.0, 12.0)
    rise = torch.linspace(-0.1, 0.1, 5)[:, None] * depths
    places = torch.stack([depths.expand_as(rise), torch.zeros_like(rise), rise], dim=-1)
    agree(net, lambda: net(points, places))
    own, other = net._rows(points, places), by_torch(lambda: net._rows(points, places))
    assert torch.equal(own[0], other[0])
    assert torch.equal(own[1], other[1])
    assert not own[1].all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 120), st.integers(1, 20), STEPS)
def test_points_of_regions(seed: int, n_points: int, count: int, step: float) -> None:
    points, rng = clouds(seed, 2, n_points, 3, step=step), np.random.default_rng(seed)
    shape = rng.uniform(1, 6, (9, 3))
    boxes = np.column_stack([clouds(seed + 1, 9, 3), shape, rng.choice([0, 1, -2.5], 9)])
    boxes[0, 0] = 99  # holds nothing
    frames, features = torch.from_numpy(rng.integers(0, 2, 9)), torch.rand(2, n_points, 4)
    given = (points, features, torch.from_numpy(boxes).float(), frames, 0.5, count)
    for one, other in zip(pool(*given), by_torch(lambda: pool(*given)), strict=True):
        assert torch.equal(one, other)


def test_what_the_compiled_functions_do_not_take() -> None:
    """Doubles round otherwise; and what is no number, or nothing, is torch's matter."""
    points = clouds(0, 1, 5, 3)
    assert plain(1, points, points) is not None
    assert plain(1, points, points.double()) is None
    assert plain(1, points / 0) is None
    assert plain(1, points[:, :0]) is None
    assert plain(0, points) is None
    assert plain(1, points.to("meta")) is None


def test_doubles_stay_doubles() -> None:
    points, known = clouds(0, 1, 30, 3).double(), clouds(1, 1, 9, 3).double()
    found = interpolate(points, known, torch.rand(1, 9, 2, dtype=torch.float64))
    assert found.dtype == torch.float64
    assert torch.equal(farthest_points(points, 7), farthest_points(points.float(), 7))
