"""Choosing, grouping and interpolating points against plain loops."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fl3d.points.network import Backbone, Level, SetAbstraction
from fl3d.points.operators import ball_query, farthest_points, first_true, gather, interpolate


def clouds(seed: int, n_clouds: int, n_points: int) -> Tensor:
    return torch.from_numpy(
        np.random.default_rng(seed).uniform(-3, 3, (n_clouds, n_points, 3)).astype(np.float32)
    )


def plain_farthest(cloud: np.ndarray, count: int) -> list[int]:
    chosen = [0]
    while len(chosen) < count:
        nearest = [min(((point - cloud[c]) ** 2).sum() for c in chosen) for point in cloud]
        chosen.append(int(np.argmax(nearest)))
    return chosen


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 40), st.integers(1, 12))
def test_farthest_points_as_a_plain_loop_finds_them(
    seed: int, n_clouds: int, n_points: int, count: int
) -> None:
    points = clouds(seed, n_clouds, n_points)
    found = farthest_points(points, min(count, n_points))
    assert found.tolist() == [
        plain_farthest(cloud.numpy(), min(count, n_points)) for cloud in points
    ]


def test_farthest_points_by_hand() -> None:
    line = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [10, 0, 0], [4, 0, 0]]])
    assert farthest_points(line, 3).tolist() == [[0, 2, 3]]
    assert farthest_points(line, 6).shape == (1, 6)  # more than there are: they repeat


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10_000),
    st.integers(1, 3),
    st.integers(1, 40),
    st.floats(0.1, 4),
    st.integers(1, 9),
)
def test_ball_query_as_a_plain_loop_finds_it(
    seed: int, n_clouds: int, n_points: int, radius: float, count: int
) -> None:
    points, centers = clouds(seed, n_clouds, n_points), clouds(seed + 1, n_clouds, 5)
    (found,) = ball_query(points, centers, [radius], [count])
    for b, cloud in enumerate(points.numpy()):
        for m, center in enumerate(centers[b].numpy()):
            distances = np.sqrt(((cloud - center) ** 2).sum(axis=1))
            if (np.abs(distances - radius) < 1e-5).any():
                continue  # rounding decides
            inside = np.flatnonzero(distances < radius)[:count].tolist() or [0]
            assert found[b, m].tolist() == inside + [inside[0]] * (count - len(inside))


def test_balls_of_several_radii_and_in_parts_are_those_of_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = clouds(0, 3, 30)
    whole = ball_query(points, points[:, :7], [0.5, 2.0], [4, 8])
    monkeypatch.setattr("fl3d.points.operators.PAIRS_AT_ONCE", 1)
    for radius, count, one in zip((0.5, 2.0), (4, 8), whole, strict=True):
        assert torch.equal(ball_query(points, points[:, :7], [radius], [count])[0], one)


def test_first_true_by_hand() -> None:
    mask = torch.tensor([[False, True, False, True, True], [False] * 5, [True] * 5])
    assert first_true(mask, 2).tolist() == [[1, 3], [0, 0], [0, 1]]
    assert first_true(mask, 4).tolist() == [[1, 3, 4, 1], [0, 0, 0, 0], [0, 1, 2, 3]]
    assert first_true(mask[None, None], 1).shape == (1, 1, 3, 1)


def test_gather_takes_rows_of_the_own_cloud() -> None:
    rows = torch.arange(12.0).view(2, 3, 2)
    assert gather(rows, torch.tensor([[2, 0], [1, 1]])).tolist() == [
        [[4, 5], [0, 1]],
        [[8, 9], [8, 9]],
    ]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 20), st.integers(1, 8))
def test_interpolation_as_a_plain_loop_finds_it(seed: int, n_points: int, n_known: int) -> None:
    points, known = clouds(seed, 2, n_points), clouds(seed + 1, 2, n_known)
    features = torch.from_numpy(
        np.random.default_rng(seed).normal(size=(2, n_known, 4)).astype(np.float32)
    )
    found = interpolate(points, known, features).numpy()
    for b in range(2):
        for n in range(n_points):
            distances = np.sqrt(((known[b] - points[b, n]).numpy() ** 2).sum(axis=1))
            near = np.argsort(distances)[:3]
            weights = 1 / (distances[near] + 1e-8)
            expected = (features[b].numpy()[near] * (weights / weights.sum())[:, None]).sum(axis=0)
            np.testing.assert_allclose(found[b, n], expected, rtol=1e-3, atol=1e-4)


def test_a_known_point_keeps_its_feature() -> None:
    known = clouds(0, 1, 6)
    features = torch.randn(1, 6, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(interpolate(known, known, features), features, rtol=1e-4, atol=1e-4)


def test_a_level_of_all_points_is_their_maximum() -> None:
    level = SetAbstraction(2, Level(None, [0.0], [1], [[5]]), norm=False)
    points, features = clouds(0, 2, 9), torch.ones(2, 9, 2)
    _, found = level(points, features)
    rows = level.scales[0](torch.cat([points, features], dim=-1))
    assert torch.equal(found, rows.amax(dim=1, keepdim=True))


def test_a_backbone_does_not_see_where_the_cloud_stands() -> None:
    """Only differences of coordinates enter: PointNet++ is blind to a shift, but for rounding."""
    torch.manual_seed(0)
    levels = [Level(12, [1.0, 2.0], [4, 8], [[8], [8]]), Level(4, [4.0], [4], [[16]])]
    backbone = Backbone(levels, [[16], [8]]).eval()
    points = clouds(3, 2, 40)
    torch.testing.assert_close(backbone(points + 1), backbone(points), rtol=1e-3, atol=1e-4)
    assert backbone(points).shape == (2, 40, 8)


def test_features_of_a_ball_do_not_depend_on_the_order_of_its_points() -> None:
    torch.manual_seed(0)
    level = SetAbstraction(0, Level(1, [9.0], [10], [[8]]))
    level.eval()
    points = clouds(5, 1, 10)
    other = torch.cat(
        [points[:, :1], points[:, 1:].flip(1)], dim=1
    )  # the first point is the centre
    torch.testing.assert_close(level(points, None)[1], level(other, None)[1])
