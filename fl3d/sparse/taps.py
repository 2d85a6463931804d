"""Convolutions of few channels, pair by pair; compiled. The order of sums is that of the taps.

Matrix products of so few columns spend their time on moving rows about, tap by tap. Here each pair is one loop over
channels, whose counts the compiler knows: it keeps them in registers (``benchmarks/README.md``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Int = NDArray[np.int64]
Kernel = Callable[..., None]
# Products of a pair up to which this is faster than a matrix product of each tap. A kernel is compiled for each count.
FEW = 512


def add_taps(
    out: Float, rows: Float, weight: Float, rows_in: Int, rows_out: Int, offsets: Int
) -> None:
    """Add what rows give through the taps of a convolution.

    Args:
        out: (N', C'), added to.
        rows: (N, C).
        weight: (taps, C, C').
        rows_in: (P,) of all pairs, see ``Rulebook``.
        rows_out: (P,) likewise.
        offsets: (taps + 1,) likewise.
    """
    _adding(*weight.shape[1:])(out, rows, weight, rows_in, rows_out, offsets)


def tap_gradients(
    grad: Float,
    rows: Float,
    weight: Float,
    rows_in: Int,
    rows_out: Int,
    offsets: Int,
    to_rows: Float | None,
    to_weight: Float,
) -> None:
    """Add what rows and weight receive from the gradient of the output.

    Args:
        grad: (N', C').
        rows: see ``add_taps``, and so all to the offsets.
        weight: likewise.
        rows_in: likewise.
        rows_out: likewise.
        offsets: likewise.
        to_rows: (N, C), added to; None: it is not asked, as of a network's input.
        to_weight: (taps, C, C'), added to.
    """
    pairs = rows_in, rows_out, offsets
    if to_rows is None:
        _weight_gradients(*weight.shape[1:])(grad, rows, *pairs, to_weight)
    else:
        _gradients(*weight.shape[1:])(grad, rows, weight, *pairs, to_rows, to_weight)


# The counts of channels are a closure's literals, so that the compiler unrolls the inner loop and makes vectors of the
# outer one; of the rows it unrolled both, and made none, while it was told how many there are. Weights and their
# gradients lie in fresh memory, of which nothing else is a view: else it looks for overlaps at each pair, which took as
# long as the pair's products. Products and sums are fused, so that what comes out does not depend on the width of
# vectors.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}


@cache
def _adding(c_in: int, c_out: int) -> Kernel:
    @numba.njit(**_OPTIONS)
    def add(
        out: Float, rows: Float, weight: Float, rows_in: Int, rows_out: Int, offsets: Int
    ) -> None:
        own = np.empty((c_in, c_out), weight.dtype)  # fresh memory, of which nothing else is a view
        for tap in range(len(weight)):
            own[:] = weight[tap]
            for pair in range(offsets[tap], offsets[tap + 1]):
                source, into = rows[rows_in[pair]], out[rows_out[pair]]
                for j in range(c_out):
                    total = into[j]
                    for i in range(c_in):
                        total += source[i] * own[i, j]
                    into[j] = total

    kernel: Kernel = add
    return kernel


@cache
def _gradients(c_in: int, c_out: int) -> Kernel:
    @numba.njit(**_OPTIONS)
    def receive(
        grad: Float,
        rows: Float,
        weight: Float,
        rows_in: Int,
        rows_out: Int,
        offsets: Int,
        to_rows: Float,
        to_weight: Float,
    ) -> None:
        # Both in one pass over the pairs: apart, as ``_weight_gradients`` has the second, they took 25 ns for 22.
        turned = np.empty((c_out, c_in), weight.dtype)
        own = np.empty((c_in, c_out), weight.dtype)
        for tap in range(len(weight)):
            turned[:] = weight[tap].T
            own[:] = 0
            for pair in range(offsets[tap], offsets[tap + 1]):
                source, received = rows[rows_in[pair]], grad[rows_out[pair]]
                for j in range(c_out):
                    value = received[j]
                    for i in range(c_in):
                        own[i, j] += source[i] * value
                into = to_rows[rows_in[pair]]
                for i in range(len(into)):
                    total = into[i]
                    for j in range(c_out):
                        total += received[j] * turned[j, i]
                    into[i] = total
            to_weight[tap] += own

    kernel: Kernel = receive
    return kernel


@cache
def _weight_gradients(c_in: int, c_out: int) -> Kernel:
    @numba.njit(**_OPTIONS)
    def receive(
        grad: Float, rows: Float, rows_in: Int, rows_out: Int, offsets: Int, to_weight: Float
    ) -> None:
        own = np.empty((c_in, c_out), to_weight.dtype)
        for tap in range(len(to_weight)):
            own[:] = 0
            for pair in range(offsets[tap], offsets[tap + 1]):
                source, received = rows[rows_in[pair]], grad[rows_out[pair]]
                for j in range(c_out):
                    value = received[j]
                    for i in range(c_in):
                        own[i, j] += source[i] * value
            to_weight[tap] += own

    kernel: Kernel = receive
    return kernel
