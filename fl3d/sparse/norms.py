"""Batch normalisation of tensors and of background maps, with the ReLU before or behind it."""

from __future__ import annotations

from functools import cache
from typing import Any, Literal

import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from fl3d.sparse.background import BackgroundMap
from fl3d.sparse.functions import WeightedNorm
from fl3d.sparse.norm_kernels import from_running, from_statistics, gradients, statistics

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
        own = rows if rows.dtype == norm.weight.dtype else rows.to(norm.weight.dtype)
        out = _compiled(norm, *_nothing(rows.shape[1], own.dtype), own, None, relu)[1]
        return out if out.dtype == rows.dtype else out.to(rows.dtype)
    layout = x.layout
    canvas, rows = _compiled(norm, x.canvas, layout.weights, rows, layout.positions, relu)
    return BackgroundMap(canvas, rows, layout)


@cache
def _nothing(channels: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The canvas of a tensor, and for how many positions its rows stand: there are none."""
    with torch.inference_mode(False):  # else what is kept could not be trained with afterwards
        canvas = torch.empty(0, channels, dtype=dtype, device="cpu")
        return canvas, torch.empty(0, dtype=torch.float64, device="cpu")


def _compiled(
    norm: Norm, canvas: Tensor, weights: Tensor, rows: Tensor, positions: int | None, relu: Relu
) -> tuple[Tensor, Tensor]:
    if not norm.training:
        return _by_statistics(norm, canvas, rows, relu)
    n = positions or rows.numel() // rows.shape[1]
    if n == 1:
        raise ValueError(
            f"one value a channel has no statistics to train with: {tuple(rows.shape)}"
        )
    found: tuple[Tensor, Tensor] = _Normalise.apply(  # type: ignore[no-untyped-call]
        canvas, rows, norm.weight, norm.bias, weights, n, norm, relu
    )
    return found


def _remember(norm: Norm, mean: Tensor, var: Tensor, n: int) -> None:
    """Move the running statistics towards those of a batch; without gradients."""
    batches, means, variances = norm.num_batches_tracked, norm.running_mean, norm.running_var
    momentum = norm.momentum
    assert batches is not None
    assert means is not None
    assert variances is not None
    assert momentum is not None
    batches.add_(1)
    means.lerp_(mean, momentum)
    variances.lerp_(var * (n / max(1, n - 1)), momentum)


def _by_statistics(norm: Norm, canvas: Tensor, rows: Tensor, relu: Relu) -> tuple[Tensor, Tensor]:
    """In evaluation mode, without gradients."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    gamma, beta = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    known = norm.running_mean.numpy(), norm.running_var.numpy(), norm.eps, gamma, beta
    flat, own = from_running(_flat(rows), canvas.numpy(), *known, *_places(relu))
    return torch.from_numpy(own), _like(rows, flat)


def _places(relu: Relu) -> tuple[bool, bool]:
    return relu == "before", relu == "behind"


def _flat(x: Tensor) -> NDArray[Any]:
    """(N, C) or (B, C, ...) -> all numbers, channel by channel within a position."""
    return x.detach().movedim(1, -1).contiguous().view(-1).numpy()


def _like(x: Tensor, flat: NDArray[Any]) -> Tensor:
    """Inverse of ``_flat``."""
    count, channels, *places = x.shape
    return torch.from_numpy(flat).view(count, *places, channels).movedim(-1, 1)


class _Normalise(torch.autograd.Function):
    """In training, where a row of the canvas counts for as many positions as it stands for."""

    @staticmethod
    def forward(
        ctx: Any,
        canvas: Tensor,
        rows: Tensor,
        gamma: Tensor,
        beta: Tensor,
        weights: Tensor,
        n: int,
        norm: Norm,
        relu: Relu,
    ) -> tuple[Tensor, Tensor]:
        """Canvas (M, C), rows (N, C) or (B, C, ...), positions (M,) of each canvas row and in all -> both, normalised.

        The module is told what its running statistics follow.
        """
        flat, below = _flat(rows), canvas.detach().numpy()
        before, behind = _places(relu)
        counts, scale, shift = weights.numpy(), gamma.detach().numpy(), beta.detach().numpy()
        mean, inverse, batch_mean, batch_var = statistics(
            flat, below, counts, n, norm.eps, scale, before
        )
        _remember(norm, torch.from_numpy(batch_mean), torch.from_numpy(batch_var), n)
        known = mean, inverse, scale, shift, before, behind
        out, own = from_statistics(flat, below, *known)
        ctx.save_for_backward(canvas, rows, gamma, beta)
        ctx.counts, ctx.n, ctx.known = counts, n, known
        return torch.from_numpy(own), _like(rows, out)

    @staticmethod
    def backward(ctx: Any, grad_canvas: Tensor, grad_rows: Tensor) -> tuple[Any, ...]:
        """Gradients of canvas, rows, gamma and beta."""
        if torch.is_grad_enabled():  # torch's own check takes 10 us of a layer's 100
            raise RuntimeError("gradients of this normalisation have no gradients themselves")
        canvas, rows, _, _ = ctx.saved_tensors
        below = grad_canvas.contiguous().numpy(), canvas.detach().numpy(), ctx.counts
        to_rows, to_canvas, to_gamma, to_beta = gradients(
            _flat(grad_rows), _flat(rows), *below, ctx.n, *ctx.known
        )
        return (
            torch.from_numpy(to_canvas),
            _like(rows, to_rows),
            torch.from_numpy(to_gamma),
            torch.from_numpy(to_beta),
            *(None, None, None, None),
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
    with torch.no_grad():
        _remember(norm, mean, var, n)
    return BackgroundMap(canvas, rows, x.layout)
