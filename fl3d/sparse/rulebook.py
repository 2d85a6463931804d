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
    nz, ny, nx = shape
    index = np.full(batch * nz * ny * nx, -1, dtype=np.int32)
    n_taps, n = kernel[0] * kernel[1] * kernel[2], len(sites)
    counts = np.zeros(n_taps, dtype=np.int64)
    reached, reaching = (
        np.empty((n_taps, n), dtype=np.int32),
        np.empty((n_taps, n), dtype=np.int32),
    )  # place, row
    for row in range(n):
        b, z, y, x = (
            sites[row, 0],
            sites[row, 1] + padding[0],
            sites[row, 2] + padding[1],
            sites[row, 3] + padding[2],
        )
        for dz in range(z % stride[0], kernel[0], stride[0]):
            oz = (z - dz) // stride[0]
            if oz < 0 or oz >= nz:
                continue
            for dy in range(y % stride[1], kernel[1], stride[1]):
                oy = (y - dy) // stride[1]
                if oy < 0 or oy >= ny:
                    continue
                for dx in range(x % stride[2], kernel[2], stride[2]):
                    ox = (x - dx) // stride[2]
                    if ox >= 0 and ox < nx:
                        tap, place = (
                            (dz * kernel[1] + dy) * kernel[2] + dx,
                            ((b * nz + oz) * ny + oy) * nx + ox,
                        )
                        index[place] = 0
                        reached[tap, counts[tap]] = place
                        reaching[tap, counts[tap]] = row
                        counts[tap] += 1
    places = np.flatnonzero(index == 0)
    out_sites = np.empty((len(places), 4), dtype=np.int64)
    for out in range(len(places)):
        place = places[out]
        index[place] = out
        out_sites[out, 3], place = place % nx, place // nx
        out_sites[out, 2], place = place % ny, place // ny
        out_sites[out, 1], out_sites[out, 0] = place % nz, place // nz
    offsets = np.zeros(n_taps + 1, dtype=np.int64)
    offsets[1:] = np.cumsum(counts)
    rows_in, rows_out = (
        np.empty(offsets[n_taps], dtype=np.int64),
        np.empty(offsets[n_taps], dtype=np.int64),
    )
    for tap in range(n_taps):
        for k in range(counts[tap]):
            rows_in[offsets[tap] + k] = reaching[tap, k]
            rows_out[offsets[tap] + k] = index[reached[tap, k]]
    return out_sites, rows_in, rows_out, offsets
