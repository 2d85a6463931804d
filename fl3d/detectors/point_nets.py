"""The networks of PointRCNN's two stages: scores and boxes of points, and of regions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fl3d.core.errors import ConfigError, options
from fl3d.core.typed import Count, NotNegative, Positive, Share
from fl3d.detectors.bins import BinCode
from fl3d.detectors.rois import RoiRule
from fl3d.points.network import Backbone, Level, PointMLP, SetAbstraction

CLASSIFICATIONS = ("bce", "focal")


def head(c_in: int, widths: Sequence[int], c_out: int, norm: bool, dropout: float) -> nn.Sequential:
    """Layers with dropout after the first, and a bare last one."""
    first, *rest = widths
    layers: list[nn.Module] = [PointMLP(c_in, [first], norm), nn.Dropout(dropout)]
    if rest:
        layers.append(PointMLP(first, rest, norm))
    return nn.Sequential(*layers, nn.Linear(widths[-1], c_out))


@dataclass(frozen=True)
class Refinement:
    """The second stage (§3.2, §3.3).

    Args:
        search: of the box code, metres.
        bin: of the box code, metres.
        yaw_bins: over 90 degrees; opposite headings are one.
        points: of a region.
        extra: metres that a region is enlarged by on each side.
        mask: posterior above which a point is marked as foreground.
        local: widths of the layers that bring a point's own features to those of the first stage.
        merged: width of both together.
        levels: of the set abstractions.
        head: widths before the two outputs.
        rois: what it learns from.
        classification: ``focal``, under the trial's loss, or ``bce``.
        scale: largest scaling of a region's points in training.
    """

    search: Positive
    bin: Positive
    yaw_bins: Count
    points: Count
    extra: NotNegative
    mask: Share
    local: Sequence[Count]
    merged: Count
    levels: Sequence[Level]
    head: Sequence[Count]
    rois: RoiRule
    classification: str
    scale: NotNegative

    def __post_init__(self) -> None:
        if self.classification not in CLASSIFICATIONS:
            told = options(self.classification, CLASSIFICATIONS)
            raise ConfigError(
                f"detector.rcnn.classification: no choice '{self.classification}'. {told}"
            )


class RPN(nn.Module):
    """Foreground scores and boxes of all points.

    Args:
        backbone: features of points.
        head_width: of the layer before each output.
        code: of boxes.
        dropout: after that layer.
    """

    def __init__(self, backbone: Backbone, head_width: int, code: BinCode, dropout: float) -> None:
        super().__init__()
        self.backbone = backbone
        self.score = head(backbone.c_out, [head_width], 1, True, dropout)
        self.box = head(backbone.c_out, [head_width], code.width, True, dropout)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, N, 3) -> logits (B, N), codes (B, N, R) and features (B, N, C)."""
        features = self.backbone(points)
        rows = features.flatten(0, 1)
        logits, codes = self.score(rows), self.box(rows)
        return logits.view(points.shape[:2]), codes.view(*points.shape[:2], -1), features


class RCNN(nn.Module):
    """Score and box of regions.

    Args:
        sizes: of its layers.
        c_in: width of the first stage's features.
        code: of boxes.
    """

    def __init__(self, sizes: Refinement, c_in: int, code: BinCode) -> None:
        super().__init__()
        self.local = PointMLP(5, sizes.local, norm=False)
        self.merged = PointMLP(self.local.c_out + c_in, [sizes.merged], norm=False)
        self.levels, width = nn.ModuleList(), sizes.merged
        for level in sizes.levels:
            self.levels.append(SetAbstraction(width, level, norm=False))
            width = level.c_out
        self.score = head(width, sizes.head, 1, False, 0.0)
        self.box = head(width, sizes.head, code.width, False, 0.0)

    def forward(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """(R, count, 3 + 2 + C): places, mark, depth, features -> logits (R,) and codes (R, width)."""
        places, features = rows[..., :3], rows[..., 5:]
        features = self.merged(torch.cat([self.local(rows[..., :5]), features], dim=-1))
        for level in self.levels:
            places, features = level(places, features)
        return self.score(features[:, 0])[:, 0], self.box(features[:, 0])


def initialise(network: nn.Module, weights: Callable[[Tensor], Tensor]) -> None:
    """Weights by a rule, zero biases, and boxes that start at almost nothing."""
    for module in network.modules():
        if isinstance(module, nn.Linear):
            weights(module.weight)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
    nn.init.normal_(last_layer(network.box).weight, std=0.001)


def last_layer(layers: object) -> nn.Linear:
    """Of a head."""
    assert isinstance(layers, nn.Sequential)
    last = layers[-1]
    assert isinstance(last, nn.Linear)
    return last
