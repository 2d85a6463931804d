"""Greedy non-maximum suppression in the bird's-eye view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fl3d.errors import ConfigError, options
from fl3d.geometry.boxes import Array, standup
from fl3d.geometry.iou import bev_iou, image_iou

KINDS = ("standup", "rotated")


def nms(rectangles: Array, scores: Array, iou: float, kind: str, max_kept: int) -> NDArray[np.int64]:
    """Keep the best-scored rectangles that do not overlap a better one.

    Args:
        rectangles: (N, 5), see ``geometry.boxes``.
        scores: (N,); ties are kept in the given order.
        iou: a rectangle goes when its overlap with a kept one is above this.
        kind: ``standup`` compares axis-parallel hulls, as the paper's code does; ``rotated`` is exact.
        max_kept: stop after this many.

    Returns:
        indices of the kept rectangles, best score first.

    Raises:
        ConfigError: ``kind`` is unknown.
    """
    if kind not in KINDS:
        raise ConfigError(f"protocol.nms_kind: no kind '{kind}'. {options(kind, KINDS)}")
    order = np.argsort(-scores, kind="stable")
    hulls = standup(rectangles)
    kept: list[int] = []
    while len(order) and len(kept) < max_kept:
        best, order = order[0], order[1:]
        kept.append(int(best))
        if kind == "standup":
            overlap = image_iou(hulls[best : best + 1], hulls[order])[0]
        else:
            overlap = bev_iou(rectangles[best : best + 1], rectangles[order])[0]
        order = order[overlap <= iou]
    return np.array(kept, dtype=np.int64)
