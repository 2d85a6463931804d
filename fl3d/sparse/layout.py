"""Where the rows of a background map lie, and which rows a convolution brings together."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Triple = tuple[int, int, int]
Geometry = tuple[Triple, Triple, Triple]  # kernel, stride and padding along z, y, x
BLOCK = 128  # rows of a class that are summed at once on CUDA
Classes = tuple[Tensor, Tensor, Tensor]  # of each position along z, y and x: int64


@dataclass(frozen=True)
class Layout:
    """Where the rows of a map lie; depends on coordinates alone, so maps of one shape can share it.

    Args:
        batch: number of samples.
        classes: class of each position along z, y, x, counted from 0.
        sites: (N, 4) int64 batch, z, y, x of the active rows, rising, each once.
        rules: of the convolutions that were laid out beforehand, by kernel, stride and padding.
    """

    batch: int
    classes: Classes
    sites: Tensor
    rules: dict[Geometry, Rulebook] = field(default_factory=dict)

    def to(self, device: str | torch.device, non_blocking: bool = False) -> Layout:
        """The same on another device, and all that follows from it, in one copy."""
        if self.sites.device == torch.device(device):
            return self
        packed, form = pack(self)
        return unpack(packed.to(device, non_blocking=non_blocking), form)

    def __reduce__(self) -> tuple[Any, ...]:
        """From a loader's process to another it goes as one tensor, not as a hundred."""
        return unpack, pack(self)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Positions along z, y, x."""
        nz, ny, nx = (len(axis) for axis in self.classes)
        return nz, ny, nx

    @cached_property
    def n_classes(self) -> tuple[int, int, int]:
        """Classes along z, y, x."""
        nz, ny, nx = (int(axis.max()) + 1 for axis in self.classes)
        return nz, ny, nx

    @property
    def n_canvas(self) -> int:
        """Rows of the canvas."""
        nz, ny, nx = self.n_classes
        return nz * ny * nx

    @property
    def positions(self) -> int:
        """Positions in all samples."""
        nz, ny, nx = self.shape
        return self.batch * nz * ny * nx

    @property
    def fill(self) -> float:
        """Share of the positions that are active."""
        return len(self.sites) / max(1, self.positions)

    @cached_property
    def row_classes(self) -> Tensor:
        """(N,) canvas row below each active row."""
        (_, ny, nx), (cz, cy, cx) = self.n_classes, self.classes
        _, z, y, x = self.sites.unbind(1)
        return (cz[z] * ny + cy[y]) * nx + cx[x]

    @cached_property
    def order(self) -> tuple[Tensor, list[int]]:
        """Active rows sorted by class, and where each class begins and ends there."""
        order = torch.argsort(self.row_classes, stable=True)
        counts = torch.bincount(self.row_classes, minlength=self.n_canvas)
        return order, [0, *counts.cumsum(0).tolist()]

    @cached_property
    def blocks(self) -> tuple[Tensor, Tensor]:
        """A place for each active row in blocks of ``BLOCK`` rows of one class, and each block's class.

        Made without a wait for the device: there are as many blocks as there can be, and those that are not needed are
        of a class behind all others.
        """
        order = torch.argsort(self.row_classes, stable=True)
        counts = torch.bincount(self.row_classes, minlength=self.n_canvas)
        held = (counts + BLOCK - 1) // BLOCK
        ends = held.cumsum(0)
        moved = (ends - held) * BLOCK - (counts.cumsum(0) - counts)  # from a rank to its place
        ranks = torch.arange(len(order), device=order.device)
        places = torch.empty_like(order)
        places[order] = ranks + moved[self.row_classes[order]]
        most = len(order) // BLOCK + min(len(order), self.n_canvas)
        every = torch.arange(most, device=order.device)
        return places, torch.searchsorted(ends, every, right=True)

    @cached_property
    def weights(self) -> Tensor:
        """(M,) float64: for how many positions each row of the canvas stands."""
        runs = [
            torch.bincount(axis, minlength=n).double()
            for axis, n in zip(self.classes, self.n_classes, strict=True)
        ]
        every = self.batch * (runs[0][:, None, None] * runs[1][None, :, None] * runs[2]).flatten()
        return every - torch.bincount(self.row_classes, minlength=self.n_canvas).double()

    @cached_property
    def grid(self) -> Tensor:
        """(Z, Y, X) canvas row of every position."""
        (_, ny, nx), (cz, cy, cx) = self.n_classes, self.classes
        return (cz[:, None, None] * ny + cy[None, :, None]) * nx + cx

    @cached_property
    def places(self) -> Tensor:
        """(N,) place of each active row among all positions of all samples."""
        nz, ny, nx = self.shape
        b, z, y, x = self.sites.unbind(1)
        return ((b * nz + z) * ny + y) * nx + x


@dataclass(frozen=True)
class Rulebook:
    """How one convolution turns a layout into another.

    Args:
        target: layout of the output.
        rows_in: (P,) input rows of all pairs, tap after tap.
        rows_out: (P,) output rows; within a tap both are unique, so sums have one order.
        offsets: where each tap's pairs begin, and the end; taps run over z, y, x.
        patches: (M', taps) canvas row under each tap, for each row of the output's canvas; M is padding.
    """

    target: Layout
    rows_in: Tensor
    rows_out: Tensor
    offsets: list[int]
    patches: Tensor

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Rows of all pairs and their offsets, on the CPU."""
        return self.rows_in.numpy(), self.rows_out.numpy(), np.array(self.offsets)


Form = tuple[Any, ...]  # what a packed layout is made of: batch, lengths, and for each rule its own


def pack(layout: Layout) -> tuple[Tensor, Form]:
    """All numbers of a layout and of its rules, one after the other, and how long each part is."""
    parts: list[Tensor] = []
    form = _pack(layout, parts)
    return torch.cat(parts), form


def _pack(layout: Layout, parts: list[Tensor]) -> Form:
    parts += [*layout.classes, layout.sites.flatten()]
    rules = []
    for geometry, rule in layout.rules.items():
        parts += [rule.rows_in, rule.rows_out, rule.patches.flatten()]
        rules.append(
            (
                geometry,
                len(rule.rows_in),
                rule.offsets,
                tuple(rule.patches.shape),
                _pack(rule.target, parts),
            )
        )
    return (
        layout.batch,
        tuple(len(axis) for axis in layout.classes),
        len(layout.sites),
        tuple(rules),
    )


def unpack(packed: Tensor, form: Form) -> Layout:
    """Inverse of ``pack``: views of the one tensor."""
    return _unpack(packed, form, 0)[0]


def _unpack(packed: Tensor, form: Form, start: int) -> tuple[Layout, int]:
    def take(length: int) -> Tensor:
        nonlocal start
        start += length
        return packed[start - length : start]

    batch, lengths, n_sites, rules = form
    z, y, x = (take(length) for length in lengths)
    layout = Layout(batch, (z, y, x), take(4 * n_sites).view(-1, 4))
    for geometry, n_pairs, offsets, shape, target_form in rules:
        rows_in, rows_out, patches = (
            take(n_pairs),
            take(n_pairs),
            take(shape[0] * shape[1]).view(shape),
        )
        target, start = _unpack(packed, target_form, start)
        layout.rules[geometry] = Rulebook(target, rows_in, rows_out, offsets, patches)
    return layout, start
