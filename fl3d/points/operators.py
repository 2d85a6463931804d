"""Choose, group and interpolate points: in PyTorch, which compares all pairs, and on a CPU compiled, to the same bits.

Qi, Yi, Su, Guibas: PointNet++: Deep Hierarchical Feature Learning on Point Sets in a Metric Space. NIPS 2017, §3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fl3d.points.features import blended, is_single
from fl3d.points.neighbours import balls, limit, nearest
from fl3d.points.selection import farthest

PAIRS_AT_ONCE = 1 << 27  # distances held in memory: half a gigabyte
NEIGHBOURS = 3


def farthest_points(points: Tensor, count: int) -> Tensor:
    """Indices of points that cover a cloud: the first one, then always the one farthest from all chosen so far.

    Args:
        points: (B, N, 3).
        count: how many; beyond N they repeat.

    Returns:
        (B, count) int64.
    """
    arrays = plain(count, points)
    if arrays is not None:
        return torch.from_numpy(farthest(*arrays, count))
    n_clouds, n_points, _ = points.shape
    chosen = torch.zeros(n_clouds, count, dtype=torch.int64, device=points.device)
    if points.is_meta:
        return chosen
    x, y, z = (
        points[..., axis].contiguous() for axis in range(3)
    )  # reductions over an axis of three are slow
    nearest = torch.full((n_clouds, n_points), torch.inf, device=points.device, dtype=points.dtype)
    last = chosen[:, :1]
    for i in range(1, count):
        squares = (x - x.gather(1, last)).square_()
        squares += (y - y.gather(1, last)).square_()
        squares += (z - z.gather(1, last)).square_()
        torch.minimum(nearest, squares, out=nearest)
        last = nearest.argmax(dim=1, keepdim=True)
        chosen[:, i] = last[:, 0]
    return chosen


def ball_query(
    points: Tensor, centers: Tensor, radii: Sequence[float], counts: Sequence[int]
) -> list[Tensor]:
    """The first points, in the cloud's order, within each radius of each centre.

    Args:
        points: (B, N, 3).
        centers: (B, M, 3).
        radii: in metres; a point at less than the radius is inside.
        counts: how many points for each radius; the first repeats where there are fewer, point 0 where there is none.

    Returns:
        for each radius (B, M, count) int64.
    """
    if points.is_meta:
        return [
            torch.zeros(*centers.shape[:2], count, dtype=torch.int64, device="meta")
            for count in counts
        ]
    arrays = plain(min(counts), points, centers)
    if arrays is not None:
        return [
            torch.from_numpy(balls(*arrays, radius, limit(radius), count))
            for radius, count in zip(radii, counts, strict=True)
        ]
    size = max(1, PAIRS_AT_ONCE // max(1, points.shape[1] * centers.shape[1]))
    parts = []
    for some, around in zip(torch.split(points, size), torch.split(centers, size), strict=True):
        distances = torch.cdist(around, some, compute_mode="donot_use_mm_for_euclid_dist")
        parts.append(
            [
                first_true(distances < radius, count)
                for radius, count in zip(radii, counts, strict=True)
            ]
        )
    return [torch.cat(columns) for columns in zip(*parts, strict=True)]


def first_true(mask: Tensor, count: int) -> Tensor:
    """Places of the first true values along the last axis: (..., N) -> (..., count), filled as ``ball_query`` says."""
    flat = mask.flatten(0, -2)
    row, place = flat.nonzero(as_tuple=True)
    starts = torch.searchsorted(
        row, torch.arange(len(flat), device=mask.device)
    )  # faster than counting each row
    rank = torch.arange(len(row), device=mask.device) - starts[row]
    first = torch.zeros(len(flat), 1, dtype=torch.int64, device=mask.device)
    is_first, kept = rank == 0, rank < count
    first[row[is_first], 0] = place[is_first]
    out = first.expand(-1, count).clone()
    out[row[kept], rank[kept]] = place[kept]
    return out.view(*mask.shape[:-1], count)


def gather(rows: Tensor, index: Tensor) -> Tensor:
    """Rows of each cloud by index: (B, N, C), (B, ...) -> (B, ..., C)."""
    offset = torch.arange(len(rows), device=rows.device) * rows.shape[1]
    flat = index + offset.view(-1, *([1] * (index.dim() - 1)))
    return rows.flatten(0, 1).index_select(0, flat.flatten()).view(*index.shape, rows.shape[2])


def interpolate(points: Tensor, known: Tensor, features: Tensor) -> Tensor:
    """Features between points: the three nearest known ones, weighed by inverse distance (PointNet++, Eq. 2).

    Args:
        points: (B, N, 3), where features are wanted.
        known: (B, M, 3), where they are known.
        features: (B, M, C).

    Returns:
        (B, N, C).
    """
    count = min(NEIGHBOURS, known.shape[1])
    if points.is_meta:
        return features.new_empty(*points.shape[:2], features.shape[2])
    distances, index = nearest_known(points, known, count)
    weights = 1 / (distances + 1e-8)
    weights = weights / weights.sum(dim=-1, keepdim=True)
    if is_single(features, weights):
        return blended(features, index, weights)
    return (gather(features, index) * weights[..., None]).sum(dim=2)


def nearest_known(points: Tensor, known: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Distances of the nearest known points, rising, and whose: (B, N, 3), (B, M, 3) -> (B, N, count) twice."""
    arrays = plain(count, points, known)
    if arrays is None:
        return _nearest_of_all(points, known, count)
    distances, index, tied = (torch.from_numpy(found) for found in nearest(*arrays, count))
    for cloud in tied.any(dim=1).nonzero()[:, 0].tolist():  # torch says which of equals comes first
        own, rows = slice(cloud, cloud + 1), tied[cloud]
        found = _nearest_of_all(points[own, rows], known[own], count)
        distances[cloud, rows], index[cloud, rows] = found[0][0], found[1][0]
    return distances, index


def _nearest_of_all(points: Tensor, known: Tensor, count: int) -> tuple[Tensor, Tensor]:
    size = max(1, PAIRS_AT_ONCE // max(1, points.shape[1] * known.shape[1]))
    found = [
        torch.cdist(some, others, compute_mode="donot_use_mm_for_euclid_dist").topk(
            count, largest=False
        )
        for some, others in zip(torch.split(points, size), torch.split(known, size), strict=True)
    ]
    return torch.cat([one[0] for one in found]), torch.cat([one[1] for one in found])


def plain(count: int, *places: Tensor) -> list[NDArray[np.float32]] | None:
    """Places as the compiled functions take them: in the CPU's memory, single, finite, some, and some wanted.

    Args:
        count: how many are chosen.
        places: coordinates.

    Returns:
        Arrays; None where PyTorch has to do the work.
    """
    if count < 1 or not is_single(*places) or not all(torch.isfinite(one).all() for one in places):
        return None
    return [one.detach().contiguous().numpy() for one in places]
