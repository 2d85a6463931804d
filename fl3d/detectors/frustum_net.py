"""Frustum ConvNet's network: features of slabs, joined by convolutions along the frustum (§III-B)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from fl3d.core.errors import ConfigError
from fl3d.detectors.multibin import MultiBin
from fl3d.points.slabs import SlabNet, Slabs

KERNELS = ((3, 1), (3, 2), (3, 2), (3, 2))  # and strides of the four blocks' first convolutions


def conv(c_in: int, c_out: int, kernel: int, stride: int, padding: int) -> nn.Sequential:
    """A convolution along the frustum, batch normalisation, ReLU."""
    layer = nn.Conv1d(c_in, c_out, kernel, stride, padding, bias=False)
    return nn.Sequential(layer, nn.BatchNorm1d(c_out), nn.ReLU(inplace=True))


class FrustumNet(nn.Module):
    """Scores and boxes at the reference points of the second resolution.

    Args:
        slabs: four resolutions, each twice as coarse as the one before.
        reach: first and last depth, metres.
        widths: of the four blocks.
        up: channels that each of the last three blocks is brought to.
        code: of boxes; a one-hot code of its size classes stands behind every slab's feature.
        used: resolutions that it sees, 0 the finest; features of the others are zero. None: all.

    Raises:
        ConfigError: ``used`` is no list of some of the four.
    """

    def __init__(
        self,
        slabs: Sequence[Slabs],
        reach: tuple[float, float],
        widths: Sequence[int],
        up: int,
        code: MultiBin,
        used: Sequence[int] | None = None,
    ) -> None:
        super().__init__()
        self.used = sorted(set(range(len(slabs)) if used is None else used))
        if not self.used or not set(self.used) <= set(range(len(slabs))):
            raise ConfigError(
                f"detector.slabs_used: {list(used or ())} is no list of some of the resolutions 0 to {len(slabs) - 1}"
            )
        self.slabs, self.reach = slabs, reach
        self.points = nn.ModuleList(SlabNet(one) for one in slabs)
        self.kinds = len(code.sizes)
        seen = [one.widths[-1] + self.kinds for one in slabs]
        self.blocks, self.merges, self.raised = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
        c_in = seen[0]
        for i, ((kernel, stride), width) in enumerate(zip(KERNELS, widths, strict=True)):
            layers = [conv(c_in, width, kernel, stride, 1)] + (
                [conv(width, width, 3, 1, 1)] if i else []
            )
            self.blocks.append(nn.Sequential(*layers))
            if i:
                self.merges.append(conv(width + seen[i], width, 1, 1, 0))
                scale = 2 ** (i - 1)
                deconv = nn.ConvTranspose1d(width, up, scale, scale, bias=False)
                self.raised.append(nn.Sequential(deconv, nn.BatchNorm1d(up), nn.ReLU(inplace=True)))
            c_in = width
        self.score = nn.Conv1d(3 * up, 2, 1)
        self.box = nn.Conv1d(3 * up, code.width, 1)
        for module in self.modules():
            if isinstance(module, nn.Linear | nn.Conv1d | nn.ConvTranspose1d):
                nn.init.kaiming_normal_(module.weight)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def places(self, slope: Tensor, level: int) -> Tensor:
        """Reference points on the axis of each frustum, which rises by ``slope`` (K,): (K, L, 3)."""
        depths = self.slabs[level].depths(*self.reach).to(slope.device)
        rise = slope[:, None] * depths
        return torch.stack([depths.expand_as(rise), torch.zeros_like(rise), rise], dim=-1)

    def forward(self, points: Tensor, slope: Tensor, kinds: Tensor) -> tuple[Tensor, Tensor]:
        """(K, P, 3), (K,), size class (K,) -> logits of object against background (K, L) and codes (K, L, width)."""
        seen = []
        for level, net in enumerate(self.points):
            places = self.places(slope, level)
            if level in self.used:
                features = net(points, places).transpose(1, 2)
            else:
                features = points.new_zeros(
                    len(points), self.slabs[level].widths[-1], places.shape[1]
                )
            code = torch.zeros(len(points), self.kinds, features.shape[2], device=points.device)
            code[torch.arange(len(points), device=points.device), kinds] = 1
            seen.append(torch.cat([features, code], dim=1))
        x, raised, length = self.blocks[0](seen[0]), [], seen[1].shape[2]
        for block, merge, raise_, own in zip(
            self.blocks[1:], self.merges, self.raised, seen[1:], strict=True
        ):
            x = merge(torch.cat([_fit(block(x), own.shape[2]), own], dim=1))
            raised.append(_fit(raise_(x), length))
        features = torch.cat(raised, dim=1)
        logits = self.score(features)
        return logits[:, 1] - logits[:, 0], self.box(features).transpose(1, 2)


def _fit(x: Tensor, length: int) -> Tensor:
    """Cut a sequence, or fill it with zeros: (K, C, *) -> (K, C, length)."""
    return (
        x[..., :length] if x.shape[2] >= length else nn.functional.pad(x, (0, length - x.shape[2]))
    )
