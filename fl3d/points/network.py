"""PointNet++ with multi-scale grouping: set abstraction, feature propagation, and the two in a backbone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fl3d.core.typed import Count, NotNegative
from fl3d.points.features import grouped, is_single, largest
from fl3d.points.operators import ball_query, farthest_points, gather, interpolate


class PointMLP(nn.Module):
    """Linear layers with batch normalisation and ReLU, point by point: (..., c_in) -> (..., widths[-1]).

    Args:
        c_in: width of a point.
        widths: of the layers.
        norm: with batch normalisation; without it the layers have biases.
    """

    def __init__(self, c_in: int, widths: Sequence[int], norm: bool = True) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for width in widths:
            layers.append(nn.Linear(c_in, width, bias=not norm))
            layers += [nn.BatchNorm1d(width)] if norm else []
            layers.append(nn.ReLU(inplace=True))
            c_in = width
        self.layers = nn.Sequential(*layers)
        self.c_out = c_in

    def forward(self, rows: Tensor, grouped: bool = False) -> Tensor:
        """As ``Sequential``, whatever the leading axes; of groups (..., S, c_in) the largest of each."""
        *layers, last = self.layers
        out = rows.flatten(0, -2)
        for layer in layers:
            out = layer(out)
        if grouped and is_single(out):
            return largest(out.view(-1, rows.shape[-2], self.c_out)).view(*rows.shape[:-2], -1)
        out = last(out).view(*rows.shape[:-1], self.c_out)
        return out.amax(dim=-2) if grouped else out


@dataclass(frozen=True)
class Level:
    """A set abstraction.

    Args:
        count: of the points that are kept; None: one, which stands for all.
        radii: in metres, one for each scale.
        samples: points in a ball, for each scale.
        widths: of each scale's layers.
    """

    count: Count | None
    radii: Sequence[NotNegative]
    samples: Sequence[Count]
    widths: Sequence[Sequence[Count]]

    @property
    def c_out(self) -> int:
        """Width of what comes out, all scales together."""
        return sum(widths[-1] for widths in self.widths)


class SetAbstraction(nn.Module):
    """Keep points that cover the cloud, and learn a feature of the ball around each (PointNet++, §3.2 and §3.3).

    Args:
        c_in: width of a point's features, without its coordinates.
        level: its sizes.
        norm: see ``PointMLP``.
    """

    def __init__(self, c_in: int, level: Level, norm: bool = True) -> None:
        super().__init__()
        self.level = level
        self.scales = nn.ModuleList(PointMLP(3 + c_in, widths, norm) for widths in level.widths)

    def forward(self, points: Tensor, features: Tensor | None) -> tuple[Tensor, Tensor]:
        """(B, N, 3), (B, N, c_in) or None -> centres (B, M, 3) and their features (B, M, c_out)."""
        if self.level.count is None:
            rows = points if features is None else torch.cat([points, features], dim=-1)
            return points[:, :1], torch.cat(
                [mlp(rows, grouped=True)[:, None] for mlp in self.scales], dim=-1
            )
        centers = gather(points, farthest_points(points, self.level.count))
        found = []
        for index, mlp in zip(
            ball_query(points, centers, self.level.radii, self.level.samples),
            self.scales,
            strict=True,
        ):
            found.append(mlp(_group(points, centers, features, index), grouped=True))
        return centers, torch.cat(found, dim=-1)


def _group(points: Tensor, centers: Tensor, features: Tensor | None, index: Tensor) -> Tensor:
    """Points of balls as their centres see them, and their features: (B, M, S, 3 + C)."""
    if features is not None and is_single(points, features):
        return grouped(points, centers, features, index)
    rows = gather(points, index) - centers[:, :, None]
    return rows if features is None else torch.cat([rows, gather(features, index)], dim=-1)


class Backbone(nn.Module):
    """Down through set abstractions and up again: a feature for every point.

    Args:
        levels: of the way down.
        up: widths of the layers on the way up, coarse to fine, one for each level.
    """

    def __init__(self, levels: Sequence[Level], up: Sequence[Sequence[int]]) -> None:
        super().__init__()
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        widths = [0]
        for level in levels:
            self.down.append(SetAbstraction(widths[-1], level))
            widths.append(level.c_out)
        c_in = widths.pop()
        for own in up:
            self.up.append(PointMLP(c_in + widths.pop(), own))
            c_in = own[-1]
        self.c_out = c_in

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, 3) -> (B, N, c_out)."""
        clouds: list[tuple[Tensor, Tensor | None]] = [(points, None)]
        for down in self.down:
            clouds.append(down(*clouds[-1]))
        known, features = clouds.pop()
        for up in self.up:
            around, skip = clouds.pop()
            assert features is not None
            raised = interpolate(around, known, features)
            known, features = (
                around,
                up(raised if skip is None else torch.cat([raised, skip], dim=-1)),
            )
        assert features is not None
        return features
