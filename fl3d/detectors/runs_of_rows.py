"""The largest features of each voxel's points: rows of one voxel lie next to each other. Compiled on a CPU."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

Float = NDArray[np.floating[Any]]
Int = NDArray[np.int64]
jit = numba.njit(cache=True, error_model="numpy")


def largest(rows: Tensor, lengths: Tensor) -> Tensor:
    """Elementwise maximum of each run of rows; equals share the gradient.

    Args:
        rows: (P, C).
        lengths: (V,) of the runs, one at least each; their sum is P.

    Returns:
        (V, C).
    """
    if rows.is_meta:
        return rows.new_empty(lengths.shape[0], rows.shape[1])
    if rows.device.type != "cpu":
        return torch.segment_reduce(rows, "max", lengths=lengths, axis=0, unsafe=True)
    found: Tensor = _Largest.apply(rows, lengths)  # type: ignore[no-untyped-call]
    return found


def beside_largest(rows: Tensor, lengths: Tensor) -> Tensor:
    """Each row, and behind it the maximum of its run: (P, C) -> (P, 2 C); see ``largest``."""
    if rows.device.type != "cpu":
        runs = largest(rows, lengths).repeat_interleave(lengths, dim=0, output_size=len(rows))
        return torch.cat([rows, runs], dim=1)
    found: Tensor = _BesideLargest.apply(rows, lengths)  # type: ignore[no-untyped-call]
    return found


class _Largest(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: Tensor, lengths: Tensor) -> Tensor:
        found = _find(rows.detach().numpy(), lengths.numpy())
        ctx.save_for_backward(rows, lengths)
        ctx.found = found
        return torch.from_numpy(found)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        rows, lengths = ctx.saved_tensors
        out = np.zeros_like(rows.numpy())
        _share(rows.numpy(), lengths.numpy(), ctx.found, grad.contiguous().numpy(), out)
        return torch.from_numpy(out), None


class _BesideLargest(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: Tensor, lengths: Tensor) -> Tensor:
        found = _find(rows.detach().numpy(), lengths.numpy())
        ctx.save_for_backward(rows, lengths)
        ctx.found = found
        return torch.from_numpy(_beside(rows.detach().numpy(), lengths.numpy(), found))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        rows, lengths = ctx.saved_tensors
        own, sums = _split(grad.contiguous().numpy(), lengths.numpy())
        _share(rows.numpy(), lengths.numpy(), ctx.found, sums, own)
        return torch.from_numpy(own), None


@jit
def _find(rows: Float, lengths: Int) -> Float:
    channels = rows.shape[1]
    found = np.empty((len(lengths), channels), rows.dtype)
    start = 0
    for v in range(len(lengths)):
        found[v] = rows[start]
        for p in range(start + 1, start + lengths[v]):
            for c in range(channels):
                value = rows[p, c]
                if value > found[v, c] or np.isnan(value):
                    found[v, c] = value
        start += lengths[v]
    return found


@jit
def _beside(rows: Float, lengths: Int, found: Float) -> Float:
    channels = rows.shape[1]
    out = np.empty((len(rows), 2 * channels), rows.dtype)
    start = 0
    for v in range(len(lengths)):
        for p in range(start, start + lengths[v]):
            for c in range(channels):
                out[p, c] = rows[p, c]
            for c in range(channels):  # a loop of its own, of which the compiler makes vectors
                out[p, channels + c] = found[v, c]
        start += lengths[v]
    return out


@jit
def _split(grad: Float, lengths: Int) -> tuple[Float, Float]:
    """What rows receive themselves (P, C), and what the maxima of their runs do, summed (V, C)."""
    channels = grad.shape[1] // 2
    own = np.empty((len(grad), channels), grad.dtype)
    sums = np.zeros((len(lengths), channels), grad.dtype)
    start = 0
    for v in range(len(lengths)):
        for p in range(start, start + lengths[v]):
            for c in range(channels):
                own[p, c] = grad[p, c]
                sums[v, c] += grad[p, channels + c]
        start += lengths[v]
    return own, sums


@jit
def _share(rows: Float, lengths: Int, found: Float, grad: Float, out: Float) -> None:
    """Add what the maxima receive to their rows."""
    channels = rows.shape[1]
    equals, largest = np.zeros(channels, rows.dtype), np.zeros(channels, rows.dtype)
    nothing, one = rows.dtype.type(0), rows.dtype.type(1)
    start = 0
    for v in range(len(lengths)):
        equals[:] = 0
        largest[:] = found[v]
        for p in range(start, start + lengths[v]):
            for c in range(channels):
                equals[c] += one if rows[p, c] == largest[c] else nothing
        for c in range(channels):
            equals[c] = grad[v, c] / max(equals[c], one)
        for p in range(start, start + lengths[v]):
            for c in range(channels):
                out[p, c] += equals[c] if rows[p, c] == largest[c] else nothing
        start += lengths[v]
