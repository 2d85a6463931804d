"""Batch normalisation of tensors and of background maps, with the ReLU before or behind it."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.modules.batchnorm import _BatchNorm

from fl3d.sparse.background import BackgroundMap
from fl3d.sparse.functions import WeightedNorm
from fl3d.sparse.norm_kernels import from_statistics, gradients, statistics

Norm = nn.BatchNorm1d | nn.BatchNorm2d | nn.BatchNorm3d
Relu = Literal["none", "before", "behind"]
Map = Tensor | BackgroundMap


def normalise(norm: Norm, x: Map, relu: Relu = "none") -> Any:
    """Batch normalisation with the module's parameters and running statistics, which are over all positions.

    On a CPU the ReLU is done in the same pass; what comes out lies channels last there.

    Args:
        norm: the module.
        x: (N, C), (B, C, ...), or a map.
        relu: where one is.

    Returns:
        the same kind.
    """
    rows = x if isinstance(x, Tensor) else x.rows
    is_frozen = torch.is_grad_enabled() and not norm.training
    is_elsewhere = rows.device.type != "cpu" or torch.compiler.is_compiling()
    if is_elsewhere or is_frozen or not rows.numel():
        return _in_torch(norm, x, relu)
    if isinstance(x, Tensor):
        own = x.to(norm.weight.dtype)
        empty, n = own.new_zeros(0, x.shape[1]), x.numel() // x.shape[1]
        return _compiled(norm, empty, own, empty[:, 0].double(), n, relu)[1].to(x.dtype)
    canvas, rows = _compiled(norm, x.canvas, rows, x.layout.weights, x.layout.positions, relu)
    return BackgroundMap(canvas, rows, x.layout)


def _compiled(
    norm: Norm, canvas: Tensor, rows: Tensor, weights: Tensor, n: int, relu: Relu
) -> tuple[Tensor, Tensor]:
    if not norm.training:
        return _by_statistics(norm, canvas, rows, relu)
    if n == 1:
        raise ValueError(
            f"one value a channel has no statistics to train with: {tuple(rows.shape)}"
        )
    canvas, rows, mean, var = _Normalise.apply(  # type: ignore[no-untyped-call]
        canvas, rows, weights, n, norm.weight, norm.bias, norm.eps, relu
    )
    _remember(norm, mean, var, n)
    return canvas, rows


def _remember(norm: Norm, mean: Tensor, var: Tensor, n: int) -> None:
    """Move the running statistics towards those of a batch."""
    assert norm.num_batches_tracked is not None
    assert norm.running_mean is not None
    assert norm.running_var is not None
    assert norm.momentum is not None
    with torch.no_grad():
        norm.num_batches_tracked.add_(1)
        norm.running_mean.lerp_(mean, norm.momentum)
        norm.running_var.lerp_(var * (n / max(1, n - 1)), norm.momentum)


def _by_statistics(norm: Norm, canvas: Tensor, rows: Tensor, relu: Relu) -> tuple[Tensor, Tensor]:
    """In evaluation mode, without gradients."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    mean = norm.running_mean.double().numpy()
    inverse = (norm.running_var.double() + norm.eps).rsqrt().numpy()
    gamma, beta = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    flat, own = from_statistics(
        _flat(rows), canvas.numpy(), mean, inverse, gamma, beta, *_places(relu)
    )
    return torch.from_numpy(own), _like(rows, flat)


def _places(relu: Relu) -> tuple[bool, bool]:
    return relu == "before", relu == "behind"


def _flat(x: Tensor) -> NDArray[Any]:
    """(N, C) or (B, C, ...) -> all numbers, channel by channel within a position."""
    return x.detach().movedim(1, -1).contiguous().view(-1).numpy()


def _like(x: Tensor, flat: NDArray[Any]) -> Tensor:
    """Inverse of ``_flat``."""
    return torch.from_numpy(flat).view(x.movedim(1, -1).shape).movedim(-1, 1)


class _Normalise(torch.autograd.Function):
    """In training, where a row of the canvas counts for as many positions as it stands for."""

    @staticmethod
    def forward(
        ctx: Any,
        canvas: Tensor,
        rows: Tensor,
        weights: Tensor,
        n: int,
        gamma: Tensor,
        beta: Tensor,
        eps: float,
        relu: Relu,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Canvas (M, C), rows (N, C) or (B, C, ...), positions (M,) of each canvas row and in all.

        Returns:
            both normalised, and mean and variance (C,).
        """
        flat, below = _flat(rows), canvas.detach().numpy()
        before, behind = _places(relu)
        mean, var = statistics(flat, below, weights.numpy(), n, len(gamma), before)
        inverse = 1 / np.sqrt(var + eps)
        known = mean, inverse, gamma.detach().numpy(), beta.detach().numpy(), before, behind
        out, own = from_statistics(flat, below, *known)
        ctx.save_for_backward(canvas, rows, weights, gamma, beta)
        ctx.n, ctx.known = n, known
        found = torch.from_numpy(mean).to(gamma.dtype), torch.from_numpy(var).to(gamma.dtype)
        ctx.mark_non_differentiable(*found)
        return torch.from_numpy(own), _like(rows, out), *found

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_canvas: Tensor, grad_rows: Tensor, _mean: Tensor, _var: Tensor
    ) -> tuple[Any, ...]:
        """Gradients of canvas, rows, gamma and beta."""
        canvas, rows, weights, gamma, _ = ctx.saved_tensors
        below = grad_canvas.contiguous().numpy(), canvas.numpy(), weights.numpy()
        to_rows, to_canvas, to_gamma, to_beta = gradients(
            _flat(grad_rows), _flat(rows), *below, ctx.n, *ctx.known
        )
        return (
            torch.from_numpy(to_canvas),
            _like(rows, to_rows),
            *(None, None),
            torch.from_numpy(to_gamma).to(gamma.dtype),
            torch.from_numpy(to_beta).to(gamma.dtype),
            *(None, None),
        )


def _in_torch(norm: Norm, x: Map, relu: Relu) -> Any:
    """The same by torch's operations, on any device."""
    if relu == "before":
        x = rectified(x)
    x = (
        _BatchNorm.forward(norm, x.contiguous())
        if isinstance(x, Tensor)
        else _map_in_torch(norm, x)
    )
    return rectified(x) if relu == "behind" else x


def rectified(x: Map) -> Map:
    """ReLU of a tensor or of a map."""
    if isinstance(x, Tensor):
        return torch.relu(x)
    return BackgroundMap(torch.relu(x.canvas), torch.relu(x.rows), x.layout)


def _map_in_torch(norm: Norm, x: BackgroundMap) -> BackgroundMap:
    assert norm.running_mean is not None
    assert norm.running_var is not None
    if not norm.training:
        scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
        shift = norm.bias - norm.running_mean * scale
        return BackgroundMap(x.canvas * scale + shift, x.rows * scale + shift, x.layout)
    n = x.layout.positions
    weights = x.layout.weights.to(x.rows.dtype)
    canvas, rows, mean, var = WeightedNorm.apply(  # type: ignore[no-untyped-call]
        x.canvas, x.rows, weights, float(n), norm.weight, norm.bias, norm.eps
    )
    _remember(norm, mean, var, n)
    return BackgroundMap(canvas, rows, x.layout)
