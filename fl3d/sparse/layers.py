"""Drop-in modules: a tensor goes through them dense, a ``BackgroundMap`` sparse; same parameters, same function."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from fl3d.sparse.background import BackgroundMap, TakeCanvas
from fl3d.sparse.functions import TapConvolution, unlowered
from fl3d.sparse.layout import Geometry, Layout, Rulebook, Triple
from fl3d.sparse.norms import Map, Relu, normalise, rectified
from fl3d.sparse.rulebook import find_rulebook
from fl3d.sparse.taps import FEW

# A pair of rows costs the sparse convolution its products, and as much as so many more for moving it about.
MOVING = 3500
MOVING_FEW, MOVING_ONE = 350, 250  # of few channels, see ``taps``, and of one: benchmarks/README.md
DENSE_FROM = (
    0.6  # cost of the sparse convolution over the dense one's, from which on the map becomes dense
)


class SparseConvolution:
    """What the convolutions below share: how one goes over a background map.

    A 2D convolution takes the whole depth of a map for channels, as a flattened tensor would have them: it is a 3D
    convolution whose kernel is as deep as the map, and what it gives is one layer deep.
    """

    weight: Tensor
    bias: Tensor | None
    in_channels: int
    out_channels: int
    kernel_size: tuple[int, ...]

    def geometry_of_tensor(self) -> Geometry:
        """Kernel, stride and padding along z, y, x; 0 along z in two dimensions."""
        kernel, stride, padding = (
            _triple(getattr(self, k)) for k in ("kernel_size", "stride", "padding")
        )
        return kernel, stride, padding

    def geometry(self, layout: Layout) -> Geometry:
        """Kernel, stride and padding along z, y, x on a map of this layout."""
        kernel, stride, padding = self.geometry_of_tensor()
        if len(self.kernel_size) == 2:
            kernel, stride, padding = (
                (layout.shape[0], *kernel[1:]),
                (1, *stride[1:]),
                (0, *padding[1:]),
            )
        return kernel, stride, padding

    def taps(self, depth: int) -> Tensor:
        """The weight as a matrix for each tap: (taps, C, C'); ``depth`` is that of the map."""
        weight = self.weight
        if weight.dim() == 4:
            weight = weight.view(len(weight), -1, depth, *weight.shape[2:])
        return weight.permute(2, 3, 4, 1, 0).flatten(0, 2)

    def is_dense(self, layout: Layout) -> bool:
        """Whether the dense convolution would be faster; the share of pairs is about that of active positions."""
        products = self.in_channels * self.out_channels
        depth = (
            layout.shape[0] if len(self.kernel_size) == 2 else 1
        )  # whose channels have rows of their own
        moving = MOVING_FEW if products // depth <= FEW else MOVING
        moving = MOVING_ONE if self.in_channels == 1 else moving
        return layout.fill * (1 + moving / products) > DENSE_FROM

    def on_map(self, x: BackgroundMap) -> Map:
        """The convolution of a map: a map, or where it is dense a tensor."""
        if self.is_dense(x.layout):
            whole = x.dense()
            return self(whole if self.weight.dim() == 5 else whole.flatten(1, 2))  # type: ignore[operator]
        return convolve(
            x,
            self.taps(x.layout.shape[0]),
            self.bias,
            find_rulebook(x.layout, self.geometry(x.layout)),
        )


def _triple(values: Any) -> Triple:
    z, y, x = (0, *values) if len(values) == 2 else values
    return int(z), int(y), int(x)


def convolve(
    x: BackgroundMap, weight: Tensor, bias: Tensor | None, rules: Rulebook
) -> BackgroundMap:
    """Convolve canvas and rows.

    The convolution is linear: at an active site it is the convolution of the background there, plus that of what
    the active rows differ from their background by.

    Args:
        x: the map.
        weight: (taps, C, C').
        bias: (C'), or None.
        rules: which rows meet at which tap.
    """
    padded = torch.cat([x.canvas, x.canvas.new_zeros(1, x.canvas.shape[1])])
    with unlowered(weight):  # few products, that stand for most of the map
        canvas = padded[rules.patches].flatten(1) @ weight.flatten(0, 1)
    if bias is not None:
        canvas = canvas + bias
    background: Tensor = TakeCanvas.apply(x.canvas, x.layout)  # type: ignore[no-untyped-call]
    below: Tensor = TakeCanvas.apply(canvas, rules.target)  # type: ignore[no-untyped-call]
    rows: Tensor = TapConvolution.apply(x.rows - background, weight, below, rules)  # type: ignore[no-untyped-call]
    return BackgroundMap(canvas, rows, rules.target)


class Conv3d(SparseConvolution, nn.Conv3d):
    """``torch.nn.Conv3d`` without groups and dilation, on tensors or background maps."""

    def forward(self, x: Map) -> Any:
        """(B, C, Z, Y, X), or a map of that shape -> the same kind; a map with many active rows becomes dense."""
        if not isinstance(x, Tensor):
            return self.on_map(x)
        _, (stride, *_), (padding, *_) = self.geometry_of_tensor()
        if x.shape[2] == 1 == (1 + 2 * padding - self.kernel_size[0]) // stride + 1:
            return self._flat(x, padding)
        if self._fills_half_a_vector(x):
            return self._paired(x)
        return self._turned(x) if self.stride[2] == 1 and is_misjudged(x) else super().forward(x)

    def _flat(self, x: Tensor, tap: int) -> Tensor:
        """The same of a map of one layer, which meets one tap along z; the others see nothing but padding."""
        _, stride, padding = self.geometry_of_tensor()
        weight = self.weight[:, :, tap]
        flat = nn.functional.conv2d(x.squeeze(2), weight, self.bias, stride[1:], padding[1:])
        return flat.unsqueeze(2)

    def _fills_half_a_vector(self, x: Tensor) -> bool:
        """Whether the backward pass, which takes sixteen channels at once, would compute as many zeros on a CPU."""
        return (
            x.device.type == "cpu"
            and 1 < self.in_channels <= PAIRED_TO
            and self.stride[2] == 2
            and self.geometry_of_tensor()[2][2] % 2 == x.shape[4] % 2 == 0
            and x.is_contiguous(memory_format=torch.channels_last_3d)
        )

    def _paired(self, x: Tensor) -> Tensor:
        """The same of neighbours along x as one position of twice the channels, which a stride of 2 steps over."""
        (_, (sz, sy, _), (pz, py, px)) = self.geometry_of_tensor()
        pairs = torch.unflatten(x.movedim(1, -1), 3, (-1, 2)).flatten(4).movedim(-1, 1)
        weight = nn.functional.pad(self.weight, (0, self.kernel_size[2] % 2))
        weight = torch.unflatten(weight, 4, (-1, 2)).permute(0, 5, 1, 2, 3, 4).flatten(1, 2)
        return nn.functional.conv3d(pairs, weight, self.bias, (sz, sy, 1), (pz, py, px // 2))

    def _turned(self, x: Tensor) -> Tensor:
        """The same with z as the last axis."""
        (_, stride, padding), weight = self.geometry_of_tensor(), self.weight.permute(ZYX_TO_YXZ)
        turned = nn.functional.conv3d(
            x.permute(ZYX_TO_YXZ), weight, self.bias, _roll(stride), _roll(padding)
        )
        return turned.permute(YXZ_TO_ZYX).contiguous(memory_format=torch.channels_last_3d)


PAIRED_TO = 8  # channels: benchmarks/README.md
ZYX_TO_YXZ, YXZ_TO_ZYX = (0, 1, 3, 4, 2), (0, 1, 4, 2, 3)
SMALL = 20480  # values in B x C x Z x Y, up to which torch takes its slow convolution, five times slower at stride 1


def is_misjudged(x: Tensor) -> bool:
    """Whether torch would take a batch of one for too small, leaving its longest axis out of account."""
    b, c, z, y, width = x.shape
    return (
        x.device.type == "cpu"
        and x.dtype == torch.float32
        and b == 1
        and c * z * y <= SMALL < c * y * width
    )


def _roll(values: Triple) -> Triple:
    z, y, x = values
    return y, x, z


class Conv2d(SparseConvolution, nn.Conv2d):
    """``torch.nn.Conv2d`` without groups and dilation, on tensors or on background maps, whose depth are channels."""

    def forward(self, x: Map) -> Any:
        """(B, C Z, Y, X), or a map (B, C, Z, Y, X) -> the same kind, a map of Z = 1; one of many rows becomes dense."""
        return super().forward(x) if isinstance(x, Tensor) else self.on_map(x)


class ConvTranspose2d(SparseConvolution, nn.ConvTranspose2d):
    """``torch.nn.ConvTranspose2d`` without groups and dilation; of stride 1 on background maps too."""

    def geometry(self, layout: Layout) -> Geometry:
        """That of the convolution with the kernel turned about."""
        kernel, stride, padding = super().geometry(layout)
        return kernel, stride, (0, kernel[1] - 1 - padding[1], kernel[2] - 1 - padding[2])

    def taps(self, depth: int) -> Tensor:
        """The kernel turned about: (taps, C, C')."""
        weight = self.weight.flip(2, 3)
        weight = weight.view(-1, depth, *weight.shape[1:])  # (C, Z, C', ky, kx)
        return weight.permute(1, 3, 4, 0, 2).flatten(0, 2)

    def is_dense(self, layout: Layout) -> bool:
        """As of other convolutions; with a stride dense is faster, for every position of the output is reached."""
        return self.stride != (1, 1) or super().is_dense(layout)

    def forward(self, x: Map, output_size: list[int] | None = None) -> Any:
        """(B, C Z, Y, X), or a map (B, C, Z, Y, X) -> the same kind, a map of Z = 1; one of many rows becomes dense."""
        return super().forward(x, output_size) if isinstance(x, Tensor) else self.on_map(x)


def lay_out(layout: Layout | None, network: nn.Module) -> Layout | None:
    """Make the rulebooks of a chain of convolutions beforehand, in the loader's process, up to where maps become dense.

    Args:
        layout: of the chain's input, which keeps the rulebooks; None: it is dense already.
        network: the chain.

    Returns:
        the layout of its output; None where that is dense.
    """
    for module in network.modules():
        if isinstance(module, SparseConvolution) and layout is not None:
            is_dense = module.is_dense(layout)
            layout = None if is_dense else find_rulebook(layout, module.geometry(layout)).target
    return layout


class ReLU(nn.Module):
    """``torch.nn.ReLU`` on tensors or background maps."""

    def forward(self, x: Map) -> Any:
        """Any shape -> the same."""
        return rectified(x)


class BatchNorm3d(nn.BatchNorm3d):
    """``torch.nn.BatchNorm3d`` on tensors or background maps; its statistics are over all positions."""

    def forward(self, x: Map, relu: Relu = "none") -> Any:
        """(B, C, Z, Y, X), or a map of that shape -> the same kind; with the ReLU before or behind."""
        return normalise(self, x, relu)


class BatchNorm2d(nn.BatchNorm2d):
    """``torch.nn.BatchNorm2d`` on tensors or background maps of one layer."""

    def forward(self, x: Map, relu: Relu = "none") -> Any:
        """(B, C, Y, X), or a map (B, C, 1, Y, X) -> the same kind; with the ReLU before or behind."""
        return normalise(self, x, relu)


class BatchNorm1d(nn.BatchNorm1d):
    """``torch.nn.BatchNorm1d`` of rows."""

    def forward(self, x: Tensor, relu: Relu = "none") -> Any:
        """(N, C) -> (N, C); with the ReLU before or behind."""
        return normalise(self, x, relu)
