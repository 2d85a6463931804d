"""Features of points gathered, blended and compared on a CPU, forth and back in one pass each; compiled.

To the bit what PyTorch's own operations make of them one after the other: each product, quotient and sum is rounded,
and sums go in the order of the points. Features are single numbers.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from fl3d.points.grid import Float, Int


def is_single(*tensors: Tensor) -> bool:
    """Whether all are single numbers in the CPU's memory, and some."""
    return all(t.device.type == "cpu" and t.dtype == torch.float32 and t.numel() for t in tensors)


def grouped(points: Tensor, centers: Tensor, features: Tensor, index: Tensor) -> Tensor:
    """Points of groups seen from their centres, and their features.

    Args:
        points: (B, N, 3).
        centers: (B, M, 3).
        features: (B, N, C).
        index: (B, M, S).

    Returns:
        (B, M, S, 3 + C), whose gradient goes to the features.
    """
    found: Tensor = _Grouped.apply(points, centers, features, index)  # type: ignore[no-untyped-call]
    return found


def blended(features: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Weighed sums of features: (B, M, C), (B, N, K), (B, N, K) -> (B, N, C), whose gradient goes to the features."""
    found: Tensor = _Blended.apply(features, index, weights)  # type: ignore[no-untyped-call]
    return found


def largest(rows: Tensor) -> Tensor:
    """The largest of each group after a ReLU: (G, S, C) -> (G, C). Equals share the gradient."""
    found: Tensor = _Largest.apply(rows)  # type: ignore[no-untyped-call]
    return found


class _Grouped(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, points: Tensor, centers: Tensor, features: Tensor, index: Tensor
    ) -> Tensor:
        ctx.save_for_backward(index)
        ctx.n_points = points.shape[1]
        return torch.from_numpy(
            _group(_array(points), _array(centers), _array(features), _array(index))
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, None, Tensor, None]:
        (index,) = ctx.saved_tensors
        return (
            None,
            None,
            torch.from_numpy(_ungroup(_array(grad), _array(index), ctx.n_points)),
            None,
        )


class _Blended(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, index: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(index, weights)
        ctx.n_known = features.shape[1]
        return torch.from_numpy(_blend(_array(features), _array(index), _array(weights)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        index, weights = ctx.saved_tensors
        found = _unblend(_array(grad), _array(index), _array(weights), ctx.n_known)
        return torch.from_numpy(found), None, None


class _Largest(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: Tensor) -> Tensor:
        found = torch.from_numpy(_most(_array(rows)))
        ctx.save_for_backward(rows, found)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        rows, found = ctx.saved_tensors
        return torch.from_numpy(_unmost(_array(rows), _array(found), _array(grad)))


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()


@numba.njit(cache=True, error_model="numpy")
def _group(points: Float, centers: Float, features: Float, index: Int) -> Float:
    n_clouds, n_centers, count = index.shape
    width = features.shape[2]
    rows = np.empty((n_clouds, n_centers, count, 3 + width), dtype=np.float32)
    for b in range(n_clouds):
        for m in range(n_centers):
            for k in range(count):
                row, point = rows[b, m, k], index[b, m, k]
                own = features[b, point]
                for axis in range(3):
                    row[axis] = points[b, point, axis] - centers[b, m, axis]
                for c in range(width):
                    row[3 + c] = own[c]
    return rows


@numba.njit(cache=True, error_model="numpy")
def _ungroup(grad: Float, index: Int, n_points: int) -> Float:
    n_clouds, n_centers, count = index.shape
    width = grad.shape[3] - 3
    found = np.zeros((n_clouds, n_points, width), dtype=np.float32)
    for b in range(n_clouds):
        for m in range(n_centers):
            for k in range(count):
                row, own = grad[b, m, k], found[b, index[b, m, k]]
                for c in range(width):
                    own[c] += row[3 + c]
    return found


@numba.njit(cache=True, error_model="numpy")
def _blend(features: Float, index: Int, weights: Float) -> Float:
    n_clouds, n_points, count = index.shape
    width = features.shape[2]
    found = np.empty((n_clouds, n_points, width), dtype=np.float32)
    for b in range(n_clouds):
        for n in range(n_points):
            row = found[b, n]
            own, weight = features[b, index[b, n, 0]], weights[b, n, 0]
            for c in range(width):
                row[c] = own[c] * weight
            for k in range(1, count):
                own, weight = features[b, index[b, n, k]], weights[b, n, k]
                for c in range(width):
                    row[c] += own[c] * weight
    return found


@numba.njit(cache=True, error_model="numpy")
def _unblend(grad: Float, index: Int, weights: Float, n_known: int) -> Float:
    n_clouds, n_points, count = index.shape
    width = grad.shape[2]
    found = np.zeros((n_clouds, n_known, width), dtype=np.float32)
    for b in range(n_clouds):
        for n in range(n_points):
            row = grad[b, n]
            for k in range(count):
                own, weight = found[b, index[b, n, k]], weights[b, n, k]
                for c in range(width):
                    own[c] += row[c] * weight
    return found


@numba.njit(cache=True, error_model="numpy")
def _most(rows: Float) -> Float:
    n_groups, count, width = rows.shape
    found = np.zeros((n_groups, width), dtype=np.float32)
    for g in range(n_groups):
        most = found[g]
        for k in range(count):
            row = rows[g, k]
            for c in range(width):
                value = row[c]
                most[c] = (
                    value if value > most[c] or value != value else most[c]
                )  # what is no number stays
    return found


@numba.njit(cache=True, error_model="numpy")
def _unmost(rows: Float, found: Float, grad: Float) -> Float:
    n_groups, count, width = rows.shape
    out = np.empty(rows.shape, dtype=np.float32)
    zero, one = np.float32(0), np.float32(1)
    equals = np.empty(width, dtype=np.float32)
    share, rest = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    for g in range(n_groups):
        most, own = found[g], grad[g]
        equals[:] = 0
        for k in range(count):
            row = rows[g, k]
            for c in range(width):
                value = row[c] if row[c] > zero else zero
                equals[c] += one if value == most[c] else zero
        for c in range(width):
            share[c], rest[c] = own[c] / equals[c], own[c] * zero / equals[c]  # a zero has a sign
        for k in range(count):
            row, to = rows[g, k], out[g, k]
            for c in range(width):
                value = row[c]
                passed = share[c] if value == most[c] else rest[c]
                to[c] = passed if value > zero else zero
    return out
