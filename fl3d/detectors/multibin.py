"""Frustum ConvNet's box code: centre, a heading's bin and residual, a size's class and residual; and its loss.

Wang and Jia: Frustum ConvNet: Sliding Frustums to Aggregate Local Point-Wise Features for Amodal 3D Object Detection.
IROS 2019, §III-C; after Qi et al., Frustum PointNets, CVPR 2018, §4.4. Rows are x, y, z of the *centre*, h, w, l, yaw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi

import torch
import torch.nn.functional as F
from torch import Tensor

CENTER_HUBER = 3.0  # where the loss of centres turns linear, metres


@dataclass(frozen=True)
class MultiBin:
    """Boxes relative to reference points.

    Args:
        sizes: mean h, w, l of each size class, metres.
        yaw_bins: number of headings' bins; the first is centred at 0.
        weights: of ``yaw_bin``, ``yaw`` (residual), ``size`` (residual) and ``corner`` in the loss.
    """

    sizes: Sequence[Sequence[float]]
    yaw_bins: int
    weights: Mapping[str, float]

    @property
    def width(self) -> int:
        """Outputs of a place: 3 of the centre, bins and residuals of yaw, classes and residuals of size."""
        return 3 + 2 * self.yaw_bins + 4 * len(self.sizes)

    def loss(self, outputs: Tensor, boxes: Tensor, kinds: Tensor) -> dict[str, Tensor]:
        """Means over boxes of all terms, weighed: (N, width), (N, 7) relative to their places, size class (N,)."""
        if not len(boxes):
            nothing = outputs.sum() * 0
            return dict.fromkeys(("reg_center", "reg_yaw", "reg_size", "reg_corner"), nothing)
        center, yaw, yaw_rest, size, size_rest = self._split(outputs)
        step = 2 * pi / self.yaw_bins
        shifted = torch.remainder(boxes[:, 6] + step / 2, 2 * pi) / step
        chosen = shifted.floor().clamp(max=self.yaw_bins - 1).long()
        rest = 2 * (shifted - chosen - 0.5)
        own_rest = yaw_rest.gather(1, chosen[:, None])[:, 0]
        mean = boxes.new_tensor(self.sizes)[kinds]
        own_size = size_rest[torch.arange(len(kinds), device=kinds.device), kinds]
        off = (boxes[:, :3] - center).norm(dim=1)
        stretch = (own_size - (boxes[:, 3:6] - mean) / mean).norm(dim=1)
        turn = F.cross_entropy(yaw, chosen) * self.weights["yaw_bin"]
        turned = chosen * step + own_rest * (step / 2)
        decoded = torch.cat([center, own_size * mean + mean, turned[:, None]], dim=1)
        return {
            "reg_center": _huber(off, CENTER_HUBER),
            "reg_yaw": turn + self.weights["yaw"] * F.smooth_l1_loss(own_rest, rest),
            "reg_size": F.cross_entropy(size, kinds) + self.weights["size"] * _huber(stretch, 1.0),
            "reg_corner": self.weights["corner"] * _huber(corner_distance(decoded, boxes), 1.0),
        }

    def decode(self, outputs: Tensor) -> Tensor:
        """Boxes of the likeliest bins and classes, relative to their places: (N, width) -> (N, 7)."""
        center, yaw, yaw_rest, size, size_rest = self._split(outputs)
        step = 2 * pi / self.yaw_bins
        chosen = yaw.argmax(dim=1)
        turn = chosen * step + yaw_rest.gather(1, chosen[:, None])[:, 0] * (step / 2)
        kind = size.argmax(dim=1)
        mean = outputs.new_tensor(self.sizes)[kind]
        own = size_rest[torch.arange(len(kind), device=kind.device), kind]
        turn = torch.remainder(turn + pi, 2 * pi) - pi
        return torch.cat([center, own * mean + mean, turn[:, None]], dim=1)

    def _split(self, outputs: Tensor) -> tuple[Tensor, ...]:
        n = len(self.sizes)
        parts = torch.split(outputs, [3, self.yaw_bins, self.yaw_bins, n, 3 * n], dim=1)
        return (*parts[:4], parts[4].reshape(-1, n, 3))


def _huber(distances: Tensor, turn: float) -> Tensor:
    return F.huber_loss(distances, torch.zeros_like(distances), delta=turn)


def corner_distance(boxes: Tensor, others: Tensor) -> Tensor:
    """Mean distance of eight corners, front for back if that is nearer: (N, 7), (N, 7), centres -> (N,)."""
    back = torch.cat([others[:, :6], others[:, 6:] + pi], dim=1)
    own = _corners(boxes)
    return torch.minimum(*((own - _corners(one)).norm(dim=2).mean(dim=1) for one in (others, back)))


def _corners(boxes: Tensor) -> Tensor:
    """(N, 7) with centres -> (N, 8, 3)."""
    signs = boxes.new_tensor(
        [(a, b, c) for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)]
    )
    along, across, up = (
        boxes[:, place, None] * signs[:, axis] for place, axis in ((5, 0), (4, 1), (3, 2))
    )
    cos, sin = boxes[:, 6:].cos(), boxes[:, 6:].sin()
    offsets = torch.stack([along * cos - across * sin, along * sin + across * cos, up], dim=-1)
    return boxes[:, None, :3] + offsets
