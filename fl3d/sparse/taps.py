"""Convolutions of one channel, pair by pair; compiled. The order of sums is that of the taps."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Int = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def add_taps(
    out: Float, rows: Float, weight: Float, rows_in: Int, rows_out: Int, offsets: Int
) -> None:
    """Add to (N', C') what the rows (N, 1) give through a weight (taps, 1, C'); pairs are those of a ``Rulebook``."""
    for tap in range(len(weight)):
        own = weight[tap, 0]
        for pair in range(offsets[tap], offsets[tap + 1]):
            value, into = rows[rows_in[pair], 0], out[rows_out[pair]]
            for c in range(len(own)):
                into[c] += value * own[c]


@numba.njit(cache=True, error_model="numpy")
def tap_gradients(
    grad: Float,
    rows: Float,
    weight: Float,
    rows_in: Int,
    rows_out: Int,
    offsets: Int,
    to_rows: Float,
    to_weight: Float,
) -> None:
    """Add to rows (N, 1) and weight (taps, 1, C') what they receive from (N', C')."""
    for tap in range(len(weight)):
        own, into = weight[tap, 0], to_weight[tap, 0]
        for pair in range(offsets[tap], offsets[tap + 1]):
            value, received = rows[rows_in[pair], 0], grad[rows_out[pair]]
            for c in range(len(own)):
                into[c] += value * received[c]
            total = to_rows[rows_in[pair], 0]
            for c in range(len(own)):
                total += own[c] * received[c]
            to_rows[rows_in[pair], 0] = total
