"""The world as regions of interest see it: their centre at the origin, their length along x (PointRCNN, §3.3)."""

from __future__ import annotations

import torch
from torch import Tensor

from fl3d.points.operators import first_true, plain
from fl3d.points.selection import in_boxes


def pool(
    points: Tensor, features: Tensor, regions: Tensor, frames: Tensor, extra: float, count: int
) -> tuple[Tensor, Tensor]:
    """Points of regions in their own frames: centre at the origin, length along x.

    Args:
        points: (B, N, 3) in the LiDAR frame.
        features: (B, N, C).
        regions: (R, 7) ``boxes_velo``.
        frames: (R,) frame of each.
        extra: metres that a region is enlarged by on each side.
        count: the first so many points; the first repeats where there are fewer, and all are zero where there is none.

    Returns:
        (R, count, 3 + C), and whether a region holds any point (R,).
    """
    half = regions[:, [5, 4, 3]] / 2 + extra  # along x, y, z of the region
    center = centered(regions)[:, :3]
    index, held = _first_inside(points, frames, center, regions[:, 6], half, count)
    index = index + frames[:, None] * points.shape[1]
    taken = points.flatten(0, 1)[index], features.flatten(0, 1)[index]
    rows = torch.cat([to_regions(taken[0], center, regions[:, 6]), taken[1]], dim=-1)
    return rows * held[:, None, None], held


def _first_inside(
    points: Tensor, frames: Tensor, center: Tensor, yaw: Tensor, half: Tensor, count: int
) -> tuple[Tensor, Tensor]:
    """Which points of its frame come first in each region (R, count), and whether it holds any (R,)."""
    arrays = plain(count, points, center, torch.stack([yaw.cos(), yaw.sin()], dim=1), half)
    if arrays is not None:
        found = in_boxes(arrays[0], frames.numpy(), *arrays[1:], count)
        return torch.from_numpy(found[0]), torch.from_numpy(found[1])
    inside = (to_regions(points[frames], center, yaw).abs() <= half[:, None]).all(dim=-1)
    return first_true(inside, count), inside.any(dim=1)


def to_regions(places: Tensor, center: Tensor, yaw: Tensor) -> Tensor:
    """Places as regions see them: (R, N, 3), (R, 3), (R,) -> (R, N, 3)."""
    moved = places - center[:, None]
    cos, sin = yaw.cos()[:, None], yaw.sin()[:, None]
    x, y = moved[..., 0], moved[..., 1]
    return torch.stack([x * cos + y * sin, y * cos - x * sin, moved[..., 2]], dim=-1)


def relative_to_regions(boxes_velo: Tensor, regions: Tensor) -> Tensor:
    """Boxes as regions see them, centre to centre: (R, 7), (R, 7) -> (R, 7)."""
    own = centered(boxes_velo)
    moved = to_regions(own[:, None, :3], centered(regions)[:, :3], regions[:, 6])[:, 0]
    return torch.cat([moved, own[:, 3:6], own[:, 6:] - regions[:, 6:]], dim=1)


def from_regions(boxes: Tensor, regions: Tensor) -> Tensor:
    """The way back: (R, 7) boxes as regions see them -> (R, 7) ``boxes_velo``."""
    return turned_back(boxes, regions[:, 6], centered(regions)[:, :3])


def turned_back(boxes: Tensor, angle: Tensor, origin: Tensor) -> Tensor:
    """From centres in frames turned by ``angle`` (N,) at ``origin`` (N, 3) to ``boxes_velo``: (N, 7) -> (N, 7)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = boxes[:, 0] * cos - boxes[:, 1] * sin, boxes[:, 0] * sin + boxes[:, 1] * cos
    places = torch.stack([x, y, boxes[:, 2] - boxes[:, 3] / 2], dim=1) + origin
    return torch.cat([places, boxes[:, 3:6], boxes[:, 6:] + angle[:, None]], dim=1)


def centered(boxes: Tensor) -> Tensor:
    """From bottom centres to centres: (N, 7) -> (N, 7)."""
    return torch.cat([boxes[:, :2], boxes[:, 2:3] + boxes[:, 3:4] / 2, boxes[:, 3:]], dim=1)
