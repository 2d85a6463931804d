"""What the sparse layers compute, with their gradients: sums in one order, on whatever device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from fl3d.sparse.layout import Rulebook
from fl3d.sparse.taps import FEW, add_taps, tap_gradients


def unlowered(x: Tensor) -> AbstractContextManager[None]:
    """A context in which nothing on the device of ``x`` is lowered by autocast."""
    return nullcontext() if x.is_meta else torch.autocast(x.device.type, enabled=False)


@contextmanager
def each_row_once(x: Tensor) -> Iterator[None]:
    """A context for sums into rows that an index names once each: they have one order, whatever the device.

    Torch does not know, and on CUDA sorts each index to be deterministic: 437 times in a step of VoxelNet at full size
    (torch 2.11, float32).
    """
    if not (x.is_cuda and torch.are_deterministic_algorithms_enabled()):
        yield
        return
    warn_only = torch.is_deterministic_algorithms_warn_only_enabled()
    torch.use_deterministic_algorithms(False)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(True, warn_only=warn_only)


def has_few(rows: Tensor, weight: Tensor) -> bool:
    """Whether a pair of rows has too few products for a call of each tap: (N, C), (taps, C, C')."""
    is_few = weight.shape[1] * weight.shape[2] <= FEW
    return is_few and rows.device.type == "cpu" and rows.dtype != torch.bfloat16


class TapConvolution(torch.autograd.Function):
    """Tap by tap: gather rows, multiply, add. Within a tap no row comes twice, so the order of sums is fixed.

    Under autocast the products are of its type; they are added in the type of the rows.
    """

    @staticmethod
    def forward(ctx, rows: Tensor, weight: Tensor, below: Tensor, rules: Rulebook) -> Tensor:  # type: ignore[no-untyped-def]
        """(N, C), (taps, C, C') and the output's background (N', C') -> (N', C')."""
        ctx.rules, ctx.dtypes, device = rules, (rows.dtype, weight.dtype), rows.device.type
        if torch.is_autocast_enabled(device):
            low = torch.get_autocast_dtype(device)
            rows, weight = rows.to(low), weight.to(low)
        ctx.save_for_backward(rows, weight)
        out = below.clone()
        if has_few(rows, weight):
            add_taps(out.numpy(), rows.numpy(), weight.contiguous().numpy(), *rules.arrays)
            return out
        with each_row_once(out):
            for tap, (start, end) in enumerate(pairwise(rules.offsets)):
                if end > start:
                    taken = rows.index_select(0, rules.rows_in[start:end])
                    product = (taken @ weight[tap]).to(out.dtype)
                    out.index_add_(0, rules.rows_out[start:end], product)
        return out

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor | None, Tensor, Tensor, None]:  # type: ignore[no-untyped-def]
        """(N', C') -> gradients of the three; none of rows that are a network's input."""
        rows, weight = ctx.saved_tensors
        rules: Rulebook = ctx.rules
        of_rows, of_weight = ctx.dtypes
        to_rows = torch.zeros_like(rows, dtype=of_rows) if ctx.needs_input_grad[0] else None
        to_weight = torch.zeros_like(weight, dtype=of_weight)
        low = grad.to(rows.dtype)
        if has_few(rows, weight):
            numbers = low.contiguous().numpy(), rows.numpy(), weight.contiguous().numpy()
            into = None if to_rows is None else to_rows.numpy()
            tap_gradients(*numbers, *rules.arrays, into, to_weight.numpy())
            return to_rows, to_weight, grad, None
        with each_row_once(grad):
            for tap, (start, end) in enumerate(pairwise(rules.offsets)):
                if end > start:
                    source, target = rules.rows_in[start:end], rules.rows_out[start:end]
                    own = low.index_select(0, target)
                    to_weight[tap] = rows.index_select(0, source).t() @ own
                    if to_rows is not None:
                        to_rows.index_add_(0, source, (own @ weight[tap].t()).to(of_rows))
        return to_rows, to_weight, grad, None


class WeightedNorm(torch.autograd.Function):
    """Batch normalisation where a row of the canvas counts for as many positions as it stands for."""

    @staticmethod
    def forward(  # type: ignore[no-untyped-def]
        ctx,
        canvas: Tensor,
        rows: Tensor,
        weights: Tensor,
        n: float,
        gamma: Tensor,
        beta: Tensor,
        eps: float,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Canvas (M, C), rows (N, C), positions (M,) of each canvas row and in all -> both, mean and variance (C)."""
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
    def backward(
        ctx: Any, grad_canvas: Tensor, grad_rows: Tensor, _mean: Tensor, _var: Tensor
    ) -> tuple[Any, ...]:
        """Gradients of canvas, rows, gamma and beta."""
        low, high, share, gamma, inverse = ctx.saved_tensors
        to_beta = grad_canvas.sum(0) + grad_rows.sum(0)
        to_gamma = (grad_canvas * low).sum(0) + (grad_rows * high).sum(0)
        scale = gamma * inverse
        to_canvas = scale * (grad_canvas - share * (to_beta + low * to_gamma))
        to_rows = scale * (grad_rows - (to_beta + high * to_gamma) / ctx.n)
        return to_canvas, to_rows, None, None, to_gamma, to_beta, None
