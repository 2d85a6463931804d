"""The networks before and behind VoxelNet's middle layers: features of voxels, and the region proposal network.

Yun et al.: Focal Loss in 3D Object Detection, RA-L 2019, Table VII and appendix C.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fl3d.detectors.blocks import conv_block
from fl3d.detectors.runs_of_rows import beside_largest, largest
from fl3d.sparse.background import dense_bev
from fl3d.sparse.functions import unlowered
from fl3d.sparse.layers import BatchNorm1d, BatchNorm2d, Conv2d, ConvTranspose2d, lay_out
from fl3d.sparse.layout import Layout
from fl3d.sparse.norms import Map

N_FEATURES = 7  # x, y, z, reflectance, and x, y, z minus the mean of the voxel's points
BLOCK_LAYERS = (4, 6, 6)  # convolutions in the three blocks of the RPN
UPSAMPLE = ((3, 1), (2, 2), (4, 4))  # kernel and stride of the three deconvolutions


class FullyConnected(nn.Module):
    """FC, batch normalisation, ReLU (appendix C), row by row."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(c_in, c_out)
        self.norm = BatchNorm1d(c_out)

    def forward(self, rows: Tensor) -> Tensor:
        """(P, c_in) -> (P, c_out)."""
        out: Tensor = self.norm(self.linear(rows), relu="behind")
        return out


class FeatureNet(nn.Module):
    """Two voxel feature encoding layers, a fully connected one and the maximum over each voxel's points.

    Args:
        vfe: output widths of the encoding layers; half of each is the point's own, half the voxel's maximum.
        out: width of the last layer.
    """

    def __init__(self, vfe: tuple[int, int], out: int) -> None:
        super().__init__()
        self.vfe_1 = FullyConnected(N_FEATURES, vfe[0] // 2)
        self.vfe_2 = FullyConnected(vfe[0], vfe[1] // 2)
        self.fc = FullyConnected(vfe[1], out)

    def forward(self, rows: Tensor, lengths: Tensor, mask: Tensor | None) -> Tensor:
        """Encode voxels.

        Args:
            rows: (P, 7) points, those of one voxel next to each other.
            lengths: (V,) how many rows each voxel has.
            mask: (P, 1) zero for padded slots, or None where there are none.

        Returns:
            (V, out).
        """
        for layer in (self.vfe_1, self.vfe_2):
            rows = beside_largest(layer(rows), lengths)
            if mask is not None:
                rows = rows * mask
        return largest(self.fc(rows), lengths)


class Pointwise(nn.Conv2d):
    """A 2D convolution of kernel 1 as one matrix product; torch's own copies its input first, to unfold it."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__(c_in, c_out, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H, W)."""
        rows = nn.functional.linear(x.movedim(1, -1), self.weight.flatten(1), self.bias)
        return rows.movedim(-1, 1)


class RPN(nn.Module):
    """Three blocks of 2D convolutions, brought to one resolution, and the two heads.

    Args:
        c_in: channels of the bird's-eye-view map.
        widths: channels of the three blocks.
        up: channels of each deconvolution.
        norm_order: see ``blocks.conv_block``.
        stride: of the first convolution.
        classes: how many have anchors at each place.
    """

    def __init__(
        self,
        c_in: int,
        widths: tuple[int, int, int],
        up: int,
        norm_order: str,
        stride: int = 2,
        classes: int = 1,
    ) -> None:
        super().__init__()
        self.blocks, self.deconvs = nn.ModuleList(), nn.ModuleList()
        for layers, width, (kernel, rise) in zip(BLOCK_LAYERS, widths, UPSAMPLE, strict=True):
            convs = [
                Conv2d(c_in, width, 3, 2 if self.blocks else stride, 1),
                *(Conv2d(width, width, 3, 1, 1) for _ in range(layers - 1)),
            ]
            self.blocks.append(
                nn.Sequential(*(conv_block(c, BatchNorm2d(width), norm_order) for c in convs))
            )
            deconv = ConvTranspose2d(width, up, kernel, rise, padding=(kernel - rise) // 2)
            self.deconvs.append(conv_block(deconv, BatchNorm2d(up), norm_order))
            c_in = width
        self.prob = Pointwise(3 * up, 2 * classes)
        self.reg = Pointwise(3 * up, 14 * classes)

    def lay_out(self, layout: Layout | None) -> None:
        """Make the rulebooks of what is sparse in it, see ``sparse.layers.lay_out``."""
        for block, deconv in zip(self.blocks, self.deconvs, strict=True):
            layout = lay_out(layout, block)
            lay_out(layout, deconv)

    def forward(self, bev: Map) -> tuple[Tensor, Tensor]:
        """(B, C, H, W), or a map -> logits (B, H/2 * W/2 * 2) and residuals (B, H/2 * W/2 * 2, 7), of one class."""
        features = self.features(bev)
        logits = self.logits(features)
        with unlowered(features):
            residuals = self.reg(features).movedim(1, -1).reshape(len(features), -1, 7)
        return logits, residuals

    def features(self, bev: Map) -> Tensor:
        """What both heads read, (B, C', H/2, W/2)."""
        raised = []
        for block, deconv in zip(self.blocks, self.deconvs, strict=True):
            bev = block(bev)
            raised.append(dense_bev(deconv(bev)))
        return torch.cat(raised[::-1], dim=1).to(self.prob.weight.dtype)

    def logits(self, features: Tensor) -> Tensor:
        """Of all anchors, (B, A)."""
        with unlowered(features):  # scores of three digits would tie
            return self.prob(features).movedim(1, -1).flatten(1)
