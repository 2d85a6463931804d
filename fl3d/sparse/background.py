"""A feature map as a small canvas of background rows and the sites that differ from it.

After a convolution, ReLU and batch normalisation of a grid that is empty almost everywhere, the empty part is no
longer zero: it is one row of features per *class* of position, and the class depends on nothing but how near the
position is to a border, axis by axis. So a map is its canvas (a row per class) and its active rows (a row per site that
differs).
Public sparse convolutions drop the background, and so compute another function than the dense networks of the papers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from fl3d.sparse.functions import each_row_once
from fl3d.sparse.layout import BLOCK, Layout


@dataclass(frozen=True)
class BackgroundMap:
    """A feature map (B, C, Z, Y, X) that is mostly background.

    Args:
        canvas: (M, C) features of each class of background position.
        rows: (N, C) features of the active sites.
        layout: where they lie.
    """

    canvas: Tensor
    rows: Tensor
    layout: Layout

    @classmethod
    def from_voxels(cls, values: Tensor, layout: Layout) -> BackgroundMap:
        """A grid that is zero but for some voxels.

        Args:
            values: (V, C), a row for each site of the layout.
            layout: of one background class, see ``rulebook.voxel_layout``.
        """
        return cls(values.new_zeros(1, values.shape[1]), values, layout)

    def to(self, dtype: torch.dtype) -> BackgroundMap:
        """The same in another type of numbers."""
        return BackgroundMap(self.canvas.to(dtype), self.rows.to(dtype), self.layout)

    def dense(self) -> Tensor:
        """The whole map: (B, C, Z, Y, X), contiguous."""
        filled: Tensor = _Dense.apply(self.canvas, self.rows, self.layout)  # type: ignore[no-untyped-call]
        return filled


def dense(x: Tensor | BackgroundMap) -> Tensor:
    """A map as a tensor (B, C, Z, Y, X); a tensor as it is."""
    return x if isinstance(x, Tensor) else x.dense()


def dense_bev(x: Tensor | BackgroundMap) -> Tensor:
    """A map as a tensor of its bird's-eye view, the depth in the channels: (B, C Z, Y, X); such a tensor as it is."""
    return x if isinstance(x, Tensor) else x.dense().flatten(1, 2)


class _Dense(torch.autograd.Function):
    """Fill the background, then write the active rows; on a CPU channels last."""

    @staticmethod
    def forward(ctx, canvas: Tensor, rows: Tensor, layout: Layout) -> Tensor:  # type: ignore[no-untyped-def]
        ctx.layout = layout
        filled = canvas.index_select(0, layout.grid.flatten()).repeat(layout.batch, 1)
        with each_row_once(filled):
            filled.index_copy_(0, layout.places, rows)
        return laid_out(filled.view(layout.batch, *layout.shape, -1))

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, None]:  # type: ignore[no-untyped-def]
        layout: Layout = ctx.layout
        flat = grad.movedim(1, -1).flatten(0, 3)
        rows = flat.index_select(0, layout.places)
        # What the active sites received is not the background's.
        rest = flat.index_fill(0, layout.places, 0).view(layout.batch, *layout.shape, -1)
        return _sum_classes(rest.sum(0), layout), rows, None


def laid_out(x: Tensor) -> Tensor:
    """(B, ..., C) as (B, C, ...): channels last in memory on a CPU, and contiguous elsewhere.

    Convolutions of few channels take two thirds of the time so (``benchmarks/README.md``).
    """
    moved = x.movedim(-1, 1)
    return moved if x.device.type == "cpu" else moved.contiguous()


def _sum_classes(values: Tensor, layout: Layout) -> Tensor:
    """Sum (Z, Y, X, C) over the positions of each class: (M, C)."""
    for axis, (classes, n) in enumerate(zip(layout.classes, layout.n_classes, strict=True)):
        parts = []
        for k in range(n):
            places = torch.nonzero(classes == k).flatten()
            parts.append(values.index_select(axis, places).sum(axis, keepdim=True))
        values = torch.cat(parts, dim=axis)
    return values.flatten(0, 2)


def _spans(offsets: list[int]) -> list[tuple[int, int]]:
    return list(pairwise(offsets))


class TakeCanvas(torch.autograd.Function):
    """The canvas row below each active row; its gradient is summed class by class, pairwise and in one order."""

    @staticmethod
    def forward(ctx, canvas: Tensor, layout: Layout) -> Tensor:  # type: ignore[no-untyped-def]
        """(M, C) -> (N, C)."""
        ctx.layout = layout
        return canvas.index_select(0, layout.row_classes)

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:  # type: ignore[no-untyped-def]
        """(N, C) -> (M, C)."""
        if grad.is_cuda:
            return sum_in_blocks(grad, ctx.layout), None
        order, offsets = ctx.layout.order
        ordered = grad.index_select(0, order)
        return torch.stack([ordered[start:end].sum(0) for start, end in _spans(offsets)]), None


def sum_in_blocks(values: Tensor, layout: Layout) -> Tensor:
    """Sum (N, C) over the active rows of each class, (M, C): in one order, and in a dozen calls.

    A sum for each class is cheap on a CPU; on CUDA VoxelNet's step at full size waited for its 3600 calls.
    """
    places, owners = layout.blocks
    padded = values.new_zeros(len(owners) * BLOCK, values.shape[1])
    with each_row_once(values):
        padded.index_copy_(0, places, values)
    sums = padded.view(len(owners), BLOCK, values.shape[1]).sum(1)
    return values.new_zeros(layout.n_canvas + 1, values.shape[1]).index_add_(0, owners, sums)[:-1]
