"""Which rows of a map meet which rows of a convolution's output, tap by tap: coordinates alone decide."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fl3d.sparse.layout import Classes, Geometry, Layout, Rulebook, Triple

Int = NDArray[np.int64]


def voxel_layout(cells: Tensor, shape: Triple, batch: int) -> Layout:
    """Layout of a grid that is empty but for some voxels.

    Args:
        cells: (V, 4) int64 batch, z, y, x, rising, each once.
        shape: of the grid, z, y, x.
        batch: number of samples.
    """
    z, y, x = (torch.zeros(n, dtype=torch.int64) for n in shape)
    return Layout(batch, (z, y, x), cells)


def find_rulebook(source: Layout, geometry: Geometry) -> Rulebook:
    """The rulebook of a convolution of a layout; made, and kept there, where it is not yet known."""
    if geometry not in source.rules:
        source.rules[geometry] = make_rulebook(source, *geometry)
    return source.rules[geometry]


def make_rulebook(source: Layout, kernel: Triple, stride: Triple, padding: Triple) -> Rulebook:
    """Lay out a convolution.

    Args:
        source: layout of its input.
        kernel: taps along z, y, x.
        stride: along z, y, x.
        padding: positions of zeros before and behind each axis.
    """
    device = source.sites.device
    background = _background(
        tuple(axis.cpu().numpy().tobytes() for axis in source.classes), kernel, stride, padding
    )
    sites, rows_in, rows_out, offsets = _pairs(
        source.sites.cpu().numpy(),
        source.batch,
        np.array([len(classes) for classes in background.classes]),
        np.array(kernel),
        np.array(stride),
        np.array(padding),
    )
    z, y, x = (classes.to(device) for classes in background.classes)
    return Rulebook(
        Layout(source.batch, (z, y, x), torch.from_numpy(sites).to(device)),
        torch.from_numpy(rows_in).to(device),
        torch.from_numpy(rows_out).to(device),
        offsets.tolist(),
        background.patches.to(device),
    )


class _Background(NamedTuple):
    """What a convolution makes of the canvas: the output's classes, and the canvas rows (M', taps) under its taps."""

    classes: Classes
    patches: Tensor


@lru_cache(maxsize=256)
def _background(
    classes: tuple[bytes, ...], kernel: Triple, stride: Triple, padding: Triple
) -> _Background:
    """The same for every frame of a network, so it is worked out once."""
    source = [torch.frombuffer(bytearray(axis), dtype=torch.int64) for axis in classes]
    axes = [_axis(c, k, s, p) for c, k, s, p in zip(source, kernel, stride, padding, strict=True)]
    (z, tz), (y, ty), (x, tx) = axes
    nz, ny, nx = (int(axis.max()) + 1 for axis in source)
    tz, ty, tx = (
        tz[:, None, None, :, None, None],
        ty[None, :, None, None, :, None],
        tx[None, None, :, None, None, :],
    )
    inside = (tz >= 0) & (ty >= 0) & (tx >= 0)
    rows = torch.where(inside, (tz * ny + ty) * nx + tx, nz * ny * nx)
    return _Background((z, y, x), rows.flatten(3).flatten(0, 2))


def _axis(classes: Tensor, kernel: int, stride: int, padding: int) -> tuple[Tensor, Tensor]:
    """Classes of an axis after a convolution, and the input classes (-1: padding) under each one's taps.

    Two output positions are of one class where their taps meet the same input classes.
    """
    n_out = (len(classes) + 2 * padding - kernel) // stride + 1
    padded = torch.nn.functional.pad(classes, (padding, padding), value=-1)
    taps = padded.unfold(0, kernel, stride)[:n_out]
    table, inverse = torch.unique(taps, dim=0, return_inverse=True)
    return inverse, table


@numba.njit(cache=True, error_model="numpy")
def _pairs(
    sites: Int, batch: int, shape: Int, kernel: Int, stride: Int, padding: Int
) -> tuple[Int, Int, Int, Int]:
    """Output sites that any input site reaches, and the pairs of rows of each tap."""
    (nz, ny, nx), (sz, sy, sx) = shape, stride
    rows, quotients, starts = _by_remainder(sites, stride, padding)
    firsts = ((quotients[0] * nz + quotients[1]) * ny + quotients[2]) * nx + quotients[3]
    index = np.full(batch * nz * ny * nx, -1, dtype=np.int32)
    most = len(sites) * np.prod((kernel + stride - 1) // stride)
    rows_in, rows_out = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    offsets = np.zeros(kernel[0] * kernel[1] * kernel[2] + 1, dtype=np.int64)
    n, tap = 0, 0
    for dz in range(kernel[0]):
        for dy in range(kernel[1]):
            for dx in range(kernel[2]):
                group = ((dz % sz) * sy + dy % sy) * sx + dx % sx
                mz, my, mx = dz // sz, dy // sy, dx // sx
                back = (mz * ny + my) * nx + mx
                for k in range(starts[group], starts[group + 1]):
                    z, y, x = quotients[1, k] - mz, quotients[2, k] - my, quotients[3, k] - mx
                    if 0 <= z < nz and 0 <= y < ny and 0 <= x < nx:
                        rows_in[n], rows_out[n] = rows[k], firsts[k] - back
                        n += 1
                tap += 1
                offsets[tap] = n
    for pair in range(n):
        index[rows_out[pair]] = 0
    out_sites = _number(index, nz, ny, nx)
    for pair in range(n):
        rows_out[pair] = index[rows_out[pair]]
    return out_sites, rows_in[:n], rows_out[:n], offsets


@numba.njit(cache=True, error_model="numpy")
def _by_remainder(sites: Int, stride: Int, padding: Int) -> tuple[Int, Int, Int]:
    """Rows by the remainders of their padded z, y, x over the stride, in their order: a tap meets one such group.

    Returns:
        (N,) rows, group by group; (4, N) batch and quotients of each; where each group begins, and the end.
    """
    groups = stride[0] * stride[1] * stride[2]
    own, starts = np.empty(len(sites), dtype=np.int64), np.zeros(groups + 1, dtype=np.int64)
    for row in range(len(sites)):
        own[row] = 0
        for axis in range(3):
            own[row] *= stride[axis]
            own[row] += (sites[row, axis + 1] + padding[axis]) % stride[axis]
        starts[own[row] + 1] += 1
    starts = np.cumsum(starts)
    rows, quotients = (
        np.empty(len(sites), dtype=np.int64),
        np.empty((4, len(sites)), dtype=np.int64),
    )
    free = starts.copy()
    for row in range(len(sites)):
        k = free[own[row]]
        free[own[row]] += 1
        rows[k], quotients[0, k] = row, sites[row, 0]
        for axis in range(3):
            quotients[axis + 1, k] = (sites[row, axis + 1] + padding[axis]) // stride[axis]
    return rows, quotients, starts


@numba.njit(cache=True, error_model="numpy")
def _number(index: NDArray[np.int32], nz: int, ny: int, nx: int) -> Int:
    """Number the places that are not -1, in place; (N', 4) batch, z, y, x of each."""
    places = np.flatnonzero(index == 0)
    sites = np.empty((len(places), 4), dtype=np.int64)
    for out in range(len(places)):
        place = places[out]
        index[place] = out
        sites[out, 3], place = place % nx, place // nx
        sites[out, 2], place = place % ny, place // ny
        sites[out, 1], sites[out, 0] = place % nz, place // nz
    return sites
