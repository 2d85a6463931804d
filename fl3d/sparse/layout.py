"""Where the rows of a background map lie, and which rows a convolution brings together."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

Triple = tuple[int, int, int]
Geometry = tuple[Triple, Triple, Triple]  # kernel, stride and padding along z, y, x
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
        """The same on another device, and all that follows from it."""
        if self.sites.device == torch.device(device):
            return self
        z, y, x = (axis.to(device, non_blocking=non_blocking) for axis in self.classes)
        rules = {geometry: rule.to(device, non_blocking) for geometry, rule in self.rules.items()}
        return Layout(self.batch, (z, y, x), self.sites.to(device, non_blocking=non_blocking), rules)

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
    def weights(self) -> Tensor:
        """(M,) float64: for how many positions each row of the canvas stands."""
        runs = [
            torch.bincount(axis, minlength=n).double() for axis, n in zip(self.classes, self.n_classes, strict=True)
        ]
        every = self.batch * (runs[0][:, None, None] * runs[1][None, :, None] * runs[2]).flatten()
        return every - torch.bincount(self.row_classes, minlength=self.n_canvas).double()

    @cached_property
    def grid(self) -> Tensor:
        """(Z, Y, X) canvas row of every position."""
        (_, ny, nx), (cz, cy, cx) = self.n_classes, self.classes
        return (cz[:, None, None] * ny + cy[None, :, None]) * nx + cx

    @cached_property
    def flat(self) -> Tensor:
        """(N,) place of each active row among all positions of its sample."""
        _, ny, nx = self.shape
        _, z, y, x = self.sites.unbind(1)
        return (z * ny + y) * nx + x

    @cached_property
    def sample_offsets(self) -> list[int]:
        """Where the rows of each sample begin, and the end."""
        counts = torch.bincount(self.sites[:, 0], minlength=self.batch)
        return [0, *counts.cumsum(0).tolist()]


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

    def to(self, device: str | torch.device, non_blocking: bool = False) -> Rulebook:
        """The same on another device."""
        moved = (t.to(device, non_blocking=non_blocking) for t in (self.rows_in, self.rows_out, self.patches))
        rows_in, rows_out, patches = moved
        return Rulebook(self.target.to(device, non_blocking), rows_in, rows_out, self.offsets, patches)
