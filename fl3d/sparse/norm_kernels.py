"""Batch normalisation with the ReLU before or behind it, in two readings of a map; compiled, on one thread.

Numbers lie channel by channel within a position (channels last). Loops run over ``tiles``: a few positions side by
side, so that one instruction does many of them whatever the channels, and so that sums have one order. A block is
summed while it is in the cache, about its own mean, and blocks are joined in double precision (Chan et al. 1979): maps
that are nearly constant lose no digits.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Double = NDArray[np.float64]

TILE = 128  # numbers at least, that a loop's body takes at once
BLOCK = 32  # tiles: 16 kB of single numbers
jit = numba.njit(cache=True, error_model="numpy")


@jit
def _tiled(values: Double, like: Float) -> Float:
    """Values of channels (C,), repeated to a tile, of the type of ``like``."""
    channels = len(values)
    tile = np.empty((TILE + channels - 1) // channels * channels, like.dtype)
    _repeat(values, tile)
    return tile


@jit
def _repeat(values: Double, tile: Float) -> None:
    """Write values of channels (C,) into a tile, over and over; a remainder for each number took longer."""
    for start in range(0, len(tile), len(values)):
        for c in range(len(values)):
            tile[start + c] = values[c]


@jit
def _least(is_rectified: bool, channels: int) -> Double:
    """What numbers are taken for at least."""
    return np.full(channels, 0.0 if is_rectified else -np.inf)


@jit
def _fold(tile: Float, sums: Double) -> None:
    """Add a tile to its channels' sums."""
    for start in range(0, len(tile), len(sums)):
        for c in range(len(sums)):
            sums[c] += tile[start + c]


@jit
def _moments(x: Float, low: Float, channels: int) -> tuple[Double, Double]:
    """Mean of each channel, and the sum of squared differences from it.

    Args:
        x: (P C) flat.
        low: a tile of the least that numbers are taken for: zeros, with a ReLU before.
        channels: C.
    """
    length = len(low)
    tile, center = np.empty_like(low), np.empty_like(low)
    mean, squares = np.zeros(channels), np.zeros(channels)
    own, own_squares = np.zeros(channels), np.zeros(channels)
    middle = np.zeros(channels)
    for first in range(0, len(x), BLOCK * length):
        last = min(len(x), first + BLOCK * length)
        n, before = (last - first) // channels, first // channels
        tile[:] = 0
        for start in range(first, last, length):
            part = x[start : min(last, start + length)]
            for i in range(len(part)):
                tile[i] += low[i] if part[i] < low[i] else part[i]
        own[:] = 0
        _fold(tile, own)
        for c in range(channels):
            middle[c] = own[c] / n
        _repeat(middle, center)
        tile[:] = 0
        for start in range(first, last, length):
            part = x[start : min(last, start + length)]
            for i in range(len(part)):
                away = (low[i] if part[i] < low[i] else part[i]) - center[i]
                tile[i] += away * away
        own_squares[:] = 0
        _fold(tile, own_squares)
        for c in range(channels):
            # The centre was rounded, so the squares are about a point that is not quite the mean.
            away = middle[c] - center[c]
            step = middle[c] - mean[c]
            squares[c] += own_squares[c] - n * away * away + step * step * before * n / (before + n)
            mean[c] += step * n / (before + n)
    return mean, squares


@jit
def _normalised(
    x: Float, low: Float, mean: Float, scale: Float, shift: Float, floor: Float
) -> Float:
    """Numbers (P C), taken for ``low`` at least, minus the mean, scaled and shifted, and ``floor`` at least."""
    out = np.empty_like(x)
    for start in range(0, len(x), len(low)):
        part, into = x[start : start + len(low)], out[start : start + len(low)]
        for i in range(len(part)):
            value = low[i] if part[i] < low[i] else part[i]
            value = (value - mean[i]) * scale[i] + shift[i]
            into[i] = floor[i] if value < floor[i] else value
    return out


@jit
def _gradient_sums(
    grad: Float,
    x: Float,
    low: Float,
    mean: Float,
    scale: Float,
    shift: Float,
    floor: Float,
    channels: int,
) -> tuple[Double, Double]:
    """Sums over the positions of each channel: of the gradient, and of it times the difference from the mean."""
    length = len(low)
    tile, tile_away = np.empty_like(low), np.empty_like(low)
    sums, sums_away = np.zeros(channels), np.zeros(channels)
    nothing = x.dtype.type(0)
    for first in range(0, len(x), BLOCK * length):
        last = min(len(x), first + BLOCK * length)
        tile[:] = 0
        tile_away[:] = 0
        for start in range(first, last, length):
            end = min(last, start + length)
            part, own = x[start:end], grad[start:end]
            for i in range(len(part)):
                away = (low[i] if part[i] < low[i] else part[i]) - mean[i]
                passed = own[i] if away * scale[i] + shift[i] > floor[i] else nothing
                tile[i] += passed
                tile_away[i] += passed * away
        _fold(tile, sums)
        _fold(tile_away, sums_away)
    return sums, sums_away


@jit
def _gradient(
    grad: Float,
    x: Float,
    low: Float,
    mean: Float,
    scale: Float,
    shift: Float,
    floor: Float,
    to_mean: Float,
    to_away: Float,
) -> Float:
    """What numbers (P C) receive: ``scale grad - to_mean - to_away (x - mean)``, where the ReLUs let it through."""
    out, nothing = np.empty_like(x), x.dtype.type(0)
    for start in range(0, len(x), len(low)):
        end = start + len(low)
        part, own, into = x[start:end], grad[start:end], out[start:end]
        for i in range(len(part)):
            away = (low[i] if part[i] < low[i] else part[i]) - mean[i]
            passed = own[i] if away * scale[i] + shift[i] > floor[i] else nothing
            received = scale[i] * passed - to_mean[i] - to_away[i] * away
            into[i] = received if part[i] > low[i] else nothing
    return out


@jit
def from_statistics(
    x: Float,
    canvas: Float,
    mean: Double,
    inverse: Double,
    gamma: Float,
    beta: Float,
    before: bool,
    behind: bool,
) -> tuple[Float, Float]:
    """Normalise by known statistics.

    Args:
        x: (N C) flat, channels last.
        canvas: (M, C).
        mean: (C,).
        inverse: (C,) of the standard deviation.
        gamma: (C,) scale.
        beta: (C,) shift.
        before: whether a ReLU comes before.
        behind: whether one comes behind.

    Returns:
        both normalised.
    """
    channels = len(gamma)
    low, floor, shift = _least(before, channels), _least(behind, channels), beta.astype(np.float64)
    scale = gamma * inverse
    out = np.empty_like(canvas)
    for m in range(len(canvas)):
        for c in range(channels):
            value = (max(np.float64(canvas[m, c]), low[c]) - mean[c]) * scale[c] + shift[c]
            out[m, c] = max(value, floor[c])
    rows = _normalised(
        x, _tiled(low, x), _tiled(mean, x), _tiled(scale, x), _tiled(shift, x), _tiled(floor, x)
    )
    return rows, out


@jit
def from_running(
    x: Float,
    canvas: Float,
    running_mean: Float,
    running_var: Float,
    eps: float,
    gamma: Float,
    beta: Float,
    before: bool,
    behind: bool,
) -> tuple[Float, Float]:
    """Normalise by running statistics (C,), see ``from_statistics``."""
    mean = running_mean.astype(np.float64)
    inverse = 1 / np.sqrt(running_var.astype(np.float64) + eps)
    return from_statistics(x, canvas, mean, inverse, gamma, beta, before, behind)


@jit
def statistics(
    x: Float, canvas: Float, weights: Double, n: int, eps: float, gamma: Float, before: bool
) -> tuple[Double, Double, Float, Float]:
    """Statistics of each channel over all ``n`` positions.

    A row of the canvas stands for as many of them as ``weights`` (M,) says.

    Returns:
        mean, inverse of the standard deviation, and mean and variance of the type of ``gamma``, each (C,).
    """
    channels = len(gamma)
    low = _least(before, channels)
    own, squares = _moments(x, _tiled(low, x), channels)
    mean = own * (len(x) // channels)
    for m in range(len(canvas)):
        for c in range(channels):
            mean[c] += max(np.float64(canvas[m, c]), low[c]) * weights[m]
    mean /= n
    squares += (own - mean) ** 2 * (len(x) // channels)
    for m in range(len(canvas)):
        for c in range(channels):
            squares[c] += (max(np.float64(canvas[m, c]), low[c]) - mean[c]) ** 2 * weights[m]
    var = squares / n
    return mean, 1 / np.sqrt(var + eps), mean.astype(gamma.dtype), var.astype(gamma.dtype)


@jit
def gradients(
    grad: Float,
    x: Float,
    grad_canvas: Float,
    canvas: Float,
    weights: Double,
    n: int,
    mean: Double,
    inverse: Double,
    gamma: Float,
    beta: Float,
    before: bool,
    behind: bool,
) -> tuple[Float, Float, Float, Float]:
    """What rows, canvas, gamma and beta receive; see ``from_statistics`` and ``statistics``."""
    channels = len(gamma)
    low, floor, shift = _least(before, channels), _least(behind, channels), beta.astype(np.float64)
    scale = gamma * inverse
    tiles = (
        _tiled(low, x), _tiled(mean, x), _tiled(scale, x), _tiled(shift, x), _tiled(floor, x)
    )  # fmt: skip
    sums, sums_away = _gradient_sums(grad, x, *tiles, channels)
    passed, away = np.zeros(canvas.shape), np.zeros(canvas.shape)
    for m in range(len(canvas)):
        for c in range(channels):
            away[m, c] = max(np.float64(canvas[m, c]), low[c]) - mean[c]
            if away[m, c] * scale[c] + shift[c] > floor[c]:
                passed[m, c] = grad_canvas[m, c]
            sums[c] += passed[m, c]
            sums_away[c] += passed[m, c] * away[m, c]
    to_mean, to_away = scale * sums / n, scale * inverse**2 * sums_away / n
    rows = _gradient(grad, x, *tiles, _tiled(to_mean, x), _tiled(to_away, x))
    out = np.zeros_like(canvas)
    for m in range(len(canvas)):
        for c in range(channels):
            if canvas[m, c] > low[c]:
                shared = weights[m] * (to_mean[c] + to_away[c] * away[m, c])
                out[m, c] = scale[c] * passed[m, c] - shared
    to_gamma, to_beta = sums_away * inverse, sums
    return rows, out, to_gamma.astype(gamma.dtype), to_beta.astype(beta.dtype)
