"""Which rows of a map meet which rows of a convolution's output, tap by tap: coordinates alone decide."""

from __future__ import annotations

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fl3d.sparse.layout import Geometry, Layout, Rulebook, Triple

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
    axes = [_axis(c, k, s, p) for c, k, s, p in zip(source.classes, kernel, stride, padding, strict=True)]
    device = source.sites.device
    shape = tuple(len(classes) for classes, _ in axes)
    sites, rows_in, rows_out, offsets = _pairs(
        source.sites.cpu().numpy(),
        source.batch,
        np.array(shape),
        np.array(kernel),
        np.array(stride),
        np.array(padding),
    )
    classes = tuple(classes.to(device) for classes, _ in axes)
    target = Layout(source.batch, (classes[0], classes[1], classes[2]), torch.from_numpy(sites).to(device))
    return Rulebook(
        target,
        torch.from_numpy(rows_in).to(device),
        torch.from_numpy(rows_out).to(device),
        offsets.tolist(),
        _patches([table for _, table in axes], source).to(device),
    )


def _axis(classes: Tensor, kernel: int, stride: int, padding: int) -> tuple[Tensor, Tensor]:
    """Classes of an axis after a convolution, and the input classes (-1: padding) under each one's taps.

    Two output positions are of one class where their taps meet the same input classes.
    """
    n_out = (len(classes) + 2 * padding - kernel) // stride + 1
    padded = torch.nn.functional.pad(classes.cpu(), (padding, padding), value=-1)
    taps = padded.unfold(0, kernel, stride)[:n_out]
    table, inverse = torch.unique(taps, dim=0, return_inverse=True)
    return inverse, table


def _patches(tables: list[Tensor], source: Layout) -> Tensor:
    """Canvas rows under the taps of each output class: (M', taps)."""
    (_, ny, nx), (tz, ty, tx) = source.n_classes, tables
    z, y, x = tz[:, None, None, :, None, None], ty[None, :, None, None, :, None], tx[None, None, :, None, None, :]
    rows = (z * ny + y) * nx + x
    inside = (z >= 0) & (y >= 0) & (x >= 0)
    rows = torch.where(inside, rows, source.n_canvas)
    return rows.reshape(len(tz) * len(ty) * len(tx), -1)


@numba.njit(cache=True, error_model="numpy")
def _pairs(sites: Int, batch: int, shape: Int, kernel: Int, stride: Int, padding: Int) -> tuple[Int, Int, Int, Int]:
    """Output sites that any input site reaches, and the pairs of rows of each tap."""
    nz, ny, nx = shape
    index = np.full(batch * nz * ny * nx, -1, dtype=np.int32)
    n_taps = kernel[0] * kernel[1] * kernel[2]
    counts = np.zeros(n_taps, dtype=np.int64)
    for row in range(len(sites)):
        b, z, y, x = sites[row, 0], sites[row, 1] + padding[0], sites[row, 2] + padding[1], sites[row, 3] + padding[2]
        for dz in range(z % stride[0], kernel[0], stride[0]):
            oz = (z - dz) // stride[0]
            for dy in range(y % stride[1], kernel[1], stride[1]):
                oy = (y - dy) // stride[1]
                for dx in range(x % stride[2], kernel[2], stride[2]):
                    ox = (x - dx) // stride[2]
                    if 0 <= oz < nz and 0 <= oy < ny and 0 <= ox < nx:
                        index[((b * nz + oz) * ny + oy) * nx + ox] = 0
                        counts[(dz * kernel[1] + dy) * kernel[2] + dx] += 1
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
    cursor = offsets[:n_taps].copy()
    rows_in, rows_out = np.empty(offsets[n_taps], dtype=np.int64), np.empty(offsets[n_taps], dtype=np.int64)
    for row in range(len(sites)):
        b, z, y, x = sites[row, 0], sites[row, 1] + padding[0], sites[row, 2] + padding[1], sites[row, 3] + padding[2]
        for dz in range(z % stride[0], kernel[0], stride[0]):
            oz = (z - dz) // stride[0]
            for dy in range(y % stride[1], kernel[1], stride[1]):
                oy = (y - dy) // stride[1]
                for dx in range(x % stride[2], kernel[2], stride[2]):
                    ox = (x - dx) // stride[2]
                    if 0 <= oz < nz and 0 <= oy < ny and 0 <= ox < nx:
                        tap = (dz * kernel[1] + dy) * kernel[2] + dx
                        rows_in[cursor[tap]] = row
                        rows_out[cursor[tap]] = index[((b * nz + oz) * ny + oy) * nx + ox]
                        cursor[tap] += 1
    return out_sites, rows_in, rows_out, offsets
