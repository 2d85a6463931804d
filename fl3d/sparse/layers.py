"""Drop-in modules: a tensor goes through them dense, a ``BackgroundMap`` sparse; same parameters, same function."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from fl3d.sparse.background import BackgroundMap, TakeCanvas
from fl3d.sparse.layout import Geometry, Layout, Rulebook
from fl3d.sparse.rulebook import find_rulebook

Map = Tensor | BackgroundMap
# A pair of rows costs the sparse convolution its products, and as much as so many more for moving it about.
MOVING = 3500
CROWDED = 0.6  # cost of the sparse convolution over the dense one's, from which on the map goes on dense


class Conv3d(nn.Conv3d):
    """``torch.nn.Conv3d`` without groups and dilation, on tensors or background maps."""

    def forward(self, x: Map) -> Any:
        """(B, C, Z, Y, X), or a map of that shape -> the same kind; a crowded map becomes dense."""
        if isinstance(x, Tensor):
            return super().forward(x)
        if self.is_crowded(x.layout):
            return super().forward(x.dense())
        return self.apply_rules(x, find_rulebook(x.layout, self.geometry))

    def is_crowded(self, layout: Layout) -> bool:
        """Whether the dense convolution would be faster; the share of pairs is about that of active positions."""
        return layout.fill * (1 + MOVING / (self.in_channels * self.out_channels)) > CROWDED

    @property
    def geometry(self) -> Geometry:
        """Kernel, stride and padding along z, y, x."""
        kernel, stride, padding = (
            tuple(int(v) for v in getattr(self, name)) for name in ("kernel_size", "stride", "padding")
        )
        return kernel, stride, padding  # type: ignore[return-value]

    def apply_rules(self, x: BackgroundMap, rules: Rulebook) -> BackgroundMap:
        """Convolve canvas and rows.

        The convolution is linear: at an active site it is the convolution of the background there, plus that of what
        the active rows differ from their background by.
        """
        weight = self.weight.permute(2, 3, 4, 1, 0).flatten(0, 2)  # (taps, C, C')
        padded = torch.cat([x.canvas, x.canvas.new_zeros(1, x.canvas.shape[1])])
        canvas = padded[rules.patches].flatten(1) @ weight.flatten(0, 1)
        if self.bias is not None:
            canvas = canvas + self.bias
        background: Tensor = TakeCanvas.apply(x.canvas, x.layout)  # type: ignore[no-untyped-call]
        below: Tensor = TakeCanvas.apply(canvas, rules.target)  # type: ignore[no-untyped-call]
        rows: Tensor = _TapConvolution.apply(x.rows - background, weight, below, rules)  # type: ignore[no-untyped-call]
        return BackgroundMap(canvas, rows, rules.target)


def lay_out(layout: Layout, network: nn.Module) -> Layout | None:
    """Make the rulebooks of a chain of convolutions beforehand, in the loader's process, up to where it goes on dense.

    Returns:
        the layout, holding them; None where dense is faster from the first convolution on.
    """
    following = layout
    for module in network.modules():
        if isinstance(module, Conv3d):
            if module.is_crowded(following):
                break
            following = find_rulebook(following, module.geometry).target
    return layout if layout.rules else None


class _TapConvolution(torch.autograd.Function):
    """Tap by tap: gather rows, multiply, add. Within a tap no row comes twice, so the order of sums is fixed."""

    @staticmethod
    def forward(ctx, rows: Tensor, weight: Tensor, below: Tensor, rules: Rulebook) -> Tensor:  # type: ignore[no-untyped-def]
        ctx.save_for_backward(rows, weight)
        ctx.rules = rules
        out = below.clone()
        for tap, (start, end) in enumerate(zip(rules.offsets[:-1], rules.offsets[1:], strict=True)):
            if end > start:
                taken = rows.index_select(0, rules.rows_in[start:end])
                out.index_add_(0, rules.rows_out[start:end], taken @ weight[tap])
        return out

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:  # type: ignore[no-untyped-def]
        rows, weight = ctx.saved_tensors
        rules: Rulebook = ctx.rules
        to_rows, to_weight = torch.zeros_like(rows), torch.zeros_like(weight)
        for tap, (start, end) in enumerate(zip(rules.offsets[:-1], rules.offsets[1:], strict=True)):
            if end > start:
                source, target = rules.rows_in[start:end], rules.rows_out[start:end]
                own = grad.index_select(0, target)
                to_weight[tap] = rows.index_select(0, source).t() @ own
                to_rows.index_add_(0, source, own @ weight[tap].t())
        return to_rows, to_weight, grad, None


class ReLU(nn.Module):
    """``torch.nn.ReLU`` on tensors or background maps."""

    def forward(self, x: Map) -> Any:
        """Any shape -> the same."""
        if isinstance(x, Tensor):
            return torch.relu(x)
        return BackgroundMap(torch.relu(x.canvas), torch.relu(x.rows), x.layout)


class BatchNorm3d(nn.BatchNorm3d):
    """``torch.nn.BatchNorm3d`` on tensors or background maps; its statistics are over all positions."""

    def forward(self, x: Map) -> Any:
        """(B, C, Z, Y, X), or a map of that shape -> the same kind."""
        if isinstance(x, Tensor):
            return super().forward(x)
        if not self.training:
            assert self.running_mean is not None
            assert self.running_var is not None
            scale = self.weight * torch.rsqrt(self.running_var + self.eps)
            shift = self.bias - self.running_mean * scale
            return BackgroundMap(x.canvas * scale + shift, x.rows * scale + shift, x.layout)
        weights = x.layout.weights.to(x.rows.dtype)
        canvas, rows, mean, var = _WeightedNorm.apply(  # type: ignore[no-untyped-call]
            x.canvas, x.rows, weights, float(x.layout.positions), self.weight, self.bias, self.eps
        )
        self._remember(mean, var, x.layout.positions)
        return BackgroundMap(canvas, rows, x.layout)

    @torch.no_grad()
    def _remember(self, mean: Tensor, var: Tensor, n: int) -> None:
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.num_batches_tracked is not None
        assert self.momentum is not None
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(var * (n / max(1, n - 1)), self.momentum)


class _WeightedNorm(torch.autograd.Function):
    """Batch normalisation where a row of the canvas counts for as many positions as it stands for."""

    @staticmethod
    def forward(  # type: ignore[no-untyped-def]
        ctx, canvas: Tensor, rows: Tensor, weights: Tensor, n: float, gamma: Tensor, beta: Tensor, eps: float
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        # Sums of differences from the commonest row: sums of the values themselves would lose three digits.
        common = canvas[int(weights.argmax())]
        low, high = canvas - common, rows - common
        share = weights[:, None] / n
        offset = (low * share).sum(0) + high.sum(0) / n
        low, high = low - offset, high - offset
        var = (low * low * share).sum(0) + (high * high).sum(0) / n
        inverse = torch.rsqrt(var + eps)
        low, high = low * inverse, high * inverse
        ctx.save_for_backward(low, high, share, gamma, inverse)
        ctx.n = n
        ctx.mark_non_differentiable(mean := common + offset, var)
        return low * gamma + beta, high * gamma + beta, mean, var

    @staticmethod
    def backward(ctx, grad_canvas: Tensor, grad_rows: Tensor, _mean: Tensor, _var: Tensor) -> tuple[Any, ...]:  # type: ignore[no-untyped-def]
        low, high, share, gamma, inverse = ctx.saved_tensors
        to_beta = grad_canvas.sum(0) + grad_rows.sum(0)
        to_gamma = (grad_canvas * low).sum(0) + (grad_rows * high).sum(0)
        scale = gamma * inverse
        to_canvas = scale * (grad_canvas - share * (to_beta + low * to_gamma))
        to_rows = scale * (grad_rows - (to_beta + high * to_gamma) / ctx.n)
        return to_canvas, to_rows, None, None, to_gamma, to_beta, None
