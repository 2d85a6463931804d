"""Blocks that the detectors share."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fl3d.core.errors import ConfigError, options
from fl3d.sparse.background import laid_out
from fl3d.sparse.layers import ReLU
from fl3d.sparse.norms import Map

COMPUTE = ("sparse", "dense")
ORDERS = ("conv_relu_norm", "conv_norm_relu")


class _Block(nn.Sequential):
    """A convolution, then ReLU and normalisation in one pass."""

    def forward(self, x: Map) -> Any:
        """What the three make of it one after the other."""
        conv, *rest = self
        norm_is_last = isinstance(rest[0], ReLU)
        return rest[norm_is_last](conv(x), relu="before" if norm_is_last else "behind")


def conv_block(conv: nn.Module, norm: nn.Module, order: str) -> nn.Sequential:
    """A convolution with ReLU and batch normalisation.

    Args:
        conv: the convolution.
        norm: the normalisation of its output.
        order: ``conv_relu_norm`` (paper, appendix B and C) or ``conv_norm_relu`` (its code).
    """
    if order not in ORDERS:
        raise ConfigError(f"detector.norm_order: no order '{order}'. {options(order, ORDERS)}")
    after = [ReLU(), norm] if order == "conv_relu_norm" else [norm, ReLU()]
    return _Block(conv, *after)


def init_he(network: nn.Module) -> None:
    """He weights over the fan-in (He et al. 2015) and zero biases, drawn from torch's generator.

    Normal, cut at two standard deviations and widened by 1.3 in variance to make up for it, as TensorFlow's
    variance scaling does and so the paper's code.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d | nn.Linear):
            std = (1.3 * 2 / _fan_in(module)) ** 0.5
            nn.init.trunc_normal_(module.weight, std=std, a=-2 * std, b=2 * std)
            if module.bias is not None:
                nn.init.zeros_(module.bias)


def _fan_in(module: nn.Module) -> float:
    weight = module.weight
    assert isinstance(weight, Tensor)
    if isinstance(module, nn.ConvTranspose2d):  # each output pixel sees (kernel / stride)^2 taps
        taps = weight[0, 0].numel() / (module.stride[0] * module.stride[1])
        return weight.shape[0] * taps
    return weight[0].numel()


def check_compute(compute: str) -> None:
    """Refuse a way to compute that does not exist."""
    if compute not in COMPUTE:
        raise ConfigError(f"detector.compute: no choice '{compute}'. {options(compute, COMPUTE)}")


def scatter_dense(values: Tensor, cells: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Write rows into a zero grid.

    Args:
        values: (V, C).
        cells: (V, D) integer indices: batch, then the grid's axes; each at most once.
        shape: (B, *grid).

    Returns:
        (B, C, *grid).
    """
    flat = cells[:, 0]
    for axis in range(1, len(shape)):
        flat = flat * shape[axis] + cells[:, axis]
    size = int(np.prod(shape))
    dense = values.new_zeros(size, values.shape[1]).index_copy(0, flat, values)
    return laid_out(dense.view(*shape, -1))


def join(arrays: list[NDArray[np.generic]]) -> Tensor:
    """Stack equal-sized samples along a new first axis."""
    return torch.from_numpy(np.stack(arrays))


def join_ragged(arrays: list[NDArray[np.generic]]) -> Tensor:
    """Concatenate index rows of unequal number, with the sample's number put in front: (N, D) -> (sum N, 1 + D)."""
    rows = [
        np.concatenate([np.full((len(a), 1), i, dtype=a.dtype), a], axis=1)
        for i, a in enumerate(arrays)
    ]
    return torch.from_numpy(np.concatenate(rows))


def top_scores(logits: NDArray[np.floating], max_boxes: int, min_score: float) -> NDArray[np.int64]:
    """Indices of the best logits above a score, best first; ties in index order."""
    floor = np.log(min_score) - np.log1p(-min_score) if min_score > 0 else -np.inf
    above = np.flatnonzero(logits >= floor)
    return above[np.argsort(-logits[above], kind="stable")[:max_boxes]]


def top_scores_by_class(
    logits: NDArray[np.floating], kinds: NDArray[np.int64], max_boxes: int, min_score: float
) -> NDArray[np.int64]:
    """As ``top_scores``, of each class so many: (N,), (N,) -> indices, best first."""
    parts = []
    for kind in range(int(kinds.max()) + 1):
        own = np.flatnonzero(kinds == kind)
        parts.append(own[top_scores(logits[own], max_boxes, min_score)])
    every = np.concatenate(parts)
    return every if len(parts) == 1 else every[np.argsort(-logits[every], kind="stable")]


def as_array(x: Tensor) -> NDArray[np.float32]:
    """A tensor of any device and precision in NumPy."""
    found: NDArray[np.float32] = x.float().cpu().numpy()
    return found


def sigmoid(x: NDArray[np.floating]) -> NDArray[np.float64]:
    """Logistic function in double precision, so that near-certain scores stay distinct."""
    return torch.sigmoid(torch.from_numpy(x).double()).numpy()
