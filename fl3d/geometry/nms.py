"""Greedy non-maximum suppression, in the bird's-eye view or in 3D."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import ConfigError, options
from fl3d.geometry.boxes import Array, standup
from fl3d.geometry.iou import Float, corners_of, shared_area

KINDS = ("standup", "rotated", "3d")


def nms(
    rectangles: Array,
    scores: Array,
    iou: float,
    kind: str,
    max_kept: int,
    spans: Array | None = None,
) -> NDArray[np.int64]:
    """Keep the best-scored rectangles that do not overlap a better one.

    Args:
        rectangles: (N, 5), see ``geometry.boxes``.
        scores: (N,); ties are kept in the given order.
        iou: a rectangle goes when its overlap with a kept one is above this.
        kind: ``standup`` compares axis-parallel hulls, as the paper's code does; ``rotated`` is exact; ``3d`` compares
            the volumes that stand on the rectangles.
        max_kept: stop after this many.
        spans: (N, 2) lowest and highest z of each, which only ``3d`` looks at, and needs.

    Returns:
        indices of the kept rectangles, best score first.

    Raises:
        ConfigError: ``kind`` is unknown, or a number is not finite.
    """
    if kind not in KINDS:
        raise ConfigError(f"protocol.nms_kind: no kind '{kind}'. {options(kind, KINDS)}")
    if kind == "3d":
        assert spans is not None
    else:
        spans = np.broadcast_to(
            [0.0, 1.0], (len(rectangles), 2)
        )  # all of one height: volumes are areas
    order = np.argsort(-scores, kind="stable")
    rectangles = np.ascontiguousarray(rectangles, dtype=np.float64)
    hulls = standup(rectangles)
    spans = np.ascontiguousarray(spans, dtype=np.float64)
    if not (np.isfinite(hulls).all() and np.isfinite(spans).all()):
        raise ConfigError("rectangles must be finite")
    return _greedy(rectangles, spans, hulls, order, iou, kind != "standup", max_kept)


@numba.njit(cache=True)
def _overlap(a: Float, b: Float, span_a: Float, span_b: Float, p: Float, q: Float) -> float:
    """IoU of what stands on rotated rectangles; ``p`` and ``q`` are room for their corners."""
    rise = min(span_a[1], span_b[1]) - max(span_a[0], span_b[0])
    if not (a[2] > 0 and a[3] > 0 and b[2] > 0 and b[3] > 0 and rise > 0):
        return 0.0
    corners_of(a, p)
    corners_of(b, q)
    volume = shared_area(p, q) * rise
    return volume / (
        a[2] * a[3] * (span_a[1] - span_a[0]) + b[2] * b[3] * (span_b[1] - span_b[0]) - volume
    )


@numba.njit(cache=True)
def _greedy(
    rectangles: Float,
    spans: Float,
    hulls: Float,
    order: NDArray[np.int64],
    iou: float,
    rotated: bool,
    max_kept: int,
) -> NDArray[np.int64]:
    """Kept rectangles lie in lists by grid cell, so that each is compared with its neighbours alone."""
    n = len(order)
    kept = np.empty(min(n, max_kept), dtype=np.int64)
    if n == 0:
        return kept
    low_u, low_v = hulls[:, 0].min(), hulls[:, 1].min()
    span = max(hulls[:, 2].max() - low_u, hulls[:, 3].max() - low_v)
    size = max(
        (hulls[:, 2] - hulls[:, 0]).max(), (hulls[:, 3] - hulls[:, 1]).max(), span / 256, 1e-6
    )
    cells = int(span / size) + 1
    head = np.full(cells * cells, -1, dtype=np.int64)
    following = np.empty(n, dtype=np.int64)
    p, q = np.empty((4, 2)), np.empty((4, 2))
    count = 0
    for i in order:
        if count == max_kept:
            break
        # Two hulls that overlap have centres less than one cell apart.
        cu = int((0.5 * (hulls[i, 0] + hulls[i, 2]) - low_u) / size)
        cv = int((0.5 * (hulls[i, 1] + hulls[i, 3]) - low_v) / size)
        is_free = True
        for nu in range(max(0, cu - 1), min(cells, cu + 2)):
            for nv in range(max(0, cv - 1), min(cells, cv + 2)):
                j = head[nu * cells + nv]
                while j >= 0 and is_free:
                    width = min(hulls[i, 2], hulls[j, 2]) - max(hulls[i, 0], hulls[j, 0])
                    height = min(hulls[i, 3], hulls[j, 3]) - max(hulls[i, 1], hulls[j, 1])
                    if width > 0 and height > 0:
                        if rotated:
                            is_free = (
                                _overlap(rectangles[j], rectangles[i], spans[j], spans[i], p, q)
                                <= iou
                            )
                        else:
                            area_i = (hulls[i, 2] - hulls[i, 0]) * (hulls[i, 3] - hulls[i, 1])
                            area_j = (hulls[j, 2] - hulls[j, 0]) * (hulls[j, 3] - hulls[j, 1])
                            is_free = width * height / (area_i + area_j - width * height) <= iou
                    j = following[j]
        if is_free:
            kept[count] = i
            count += 1
            following[i] = head[cu * cells + cv]
            head[cu * cells + cv] = i
    return kept[:count].copy()
