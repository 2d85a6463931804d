"""Points of a frustum in overlapping slabs along its axis, and a sequence of features of them (Frustum ConvNet)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from fl3d.points.network import PointMLP
from fl3d.points.operators import first_true, plain
from fl3d.points.selection import in_slabs


@dataclass(frozen=True)
class Slabs:
    """One resolution.

    Args:
        stride: between reference points, metres.
        half: a slab reaches so far to both sides of its reference point, metres.
        samples: points of a slab at most.
        widths: of the layers over its points.
    """

    stride: float
    half: float
    samples: int
    widths: Sequence[int]

    def depths(self, start: float, end: float) -> Tensor:
        """Of the reference points, the middles of strides: (L,)."""
        count = round((end - start) / self.stride + 1e-6)
        return start + (torch.arange(count) + 0.5) * self.stride


def resolutions(columns: Mapping[str, Sequence[Any]]) -> list[Slabs]:
    """Slabs from columns of equal length, one for each of their fields, as a YAML has them."""
    return [
        Slabs(*row) for row in zip(*(columns[field.name] for field in fields(Slabs)), strict=True)
    ]


class SlabNet(nn.Module):
    """A feature for each slab: the maximum over its points; zero where it holds none.

    Args:
        slabs: its sizes.
    """

    def __init__(self, slabs: Slabs) -> None:
        super().__init__()
        self.slabs = slabs
        self.mlp = PointMLP(3, slabs.widths)

    def forward(self, points: Tensor, places: Tensor) -> Tensor:
        """(K, P, 3) and reference points (K, L, 3) -> (K, L, C); depth is the first coordinate."""
        rows, inside = self._rows(points, places)
        return self.mlp(rows, grouped=True) * inside

    def _rows(self, points: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Points of each slab seen from its reference point (K, L, samples, 3), and whether it holds any (K, L, 1)."""
        count, half = self.slabs.samples, self.slabs.half
        if points.is_meta:
            rows = points.new_zeros(*places.shape[:2], count, 3)
            return rows, rows.new_zeros(*places.shape[:2], 1, dtype=torch.bool)
        arrays = plain(count, points, places)
        if arrays is not None:
            found = in_slabs(*arrays, np.float32(half), count)
            return torch.from_numpy(found[0]), torch.from_numpy(found[1])[..., None]
        inside = (points[:, None, :, 0] - places[..., :1]).abs() < half
        first = torch.arange(len(points), device=points.device)[:, None, None] * points.shape[1]
        flat = first_true(inside, count) + first
        rows = points.flatten(0, 1)[flat.flatten()].view(*flat.shape, 3) - places[:, :, None]
        return rows, inside.any(dim=2, keepdim=True)
