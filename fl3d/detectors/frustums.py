"""Frustums behind 2D boxes: rays, turns and labels; NumPy where samples are made, tensors where networks run."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fl3d.data.calibration import Calibration
from fl3d.detectors.base import Found
from fl3d.detectors.regions import centered
from fl3d.geometry.boxes import Array, rectangles_velo, spans_velo, wrap
from fl3d.geometry.nms import nms

LEAST_SIZE = 0.01  # metres; a network may say less
SUPPRESSED = 0.1  # overlap in 3D above which the worse of two boxes is not refined


def rays(calibration: Calibration, pixels: Array) -> tuple[Array, Array]:
    """Where the camera stands, and where it looks through pixels: (N, 2) -> (3,), (N, 3), LiDAR frame."""
    inverse = np.linalg.inv(calibration.P2[:, :3])
    origin = calibration.points_to_velo((-inverse @ calibration.P2[:, 3])[None])
    ends_cam = (
        np.column_stack([pixels, np.ones(len(pixels))]) @ inverse.T - inverse @ calibration.P2[:, 3]
    )
    return origin[0], calibration.points_to_velo(ends_cam) - origin


def jittered(boxes_image: Array, shift: float, size: float, rng: np.random.Generator) -> Array:
    """2D boxes moved by up to a share of their size, and scaled: (N, 4) -> (N, 4)."""
    n = len(boxes_image)
    middle = (boxes_image[:, :2] + boxes_image[:, 2:]) / 2
    extent = boxes_image[:, 2:] - boxes_image[:, :2]
    middle = middle + extent * rng.uniform(-shift, shift, (n, 2))
    extent = extent * (1 + rng.uniform(-size, size, (n, 2)))
    return np.concatenate([middle - extent / 2, middle + extent / 2], axis=1)


def sampled(points: Array, count: int, rng: np.random.Generator) -> Array:
    """Exactly so many points in random order, some twice only where there are fewer."""
    order = rng.permutation(len(points))
    if len(order) < count:
        order = np.concatenate([order, rng.integers(len(points), size=count - len(order))])
    return points[order[:count]]


def turned(points: Array, angle: float) -> Array:
    """Points turned about the vertical: (N, 3) -> (N, 3)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack(
        [
            points[:, 0] * cos - points[:, 1] * sin,
            points[:, 0] * sin + points[:, 1] * cos,
            points[:, 2],
        ]
    )


def moved(boxes_velo: Array, shift: Array, angle: float) -> Array:
    """Boxes shifted, then turned about the vertical: (N, 7) -> (N, 7)."""
    places = turned(boxes_velo[:, :3] + shift, angle)
    return np.column_stack([places, boxes_velo[:, 3:6], wrap(boxes_velo[:, 6] + angle)])


def enlarged(boxes_velo: Array, factor: float) -> Array:
    """Boxes of so many times the size about the same centres: (N, 7) -> (N, 7)."""
    larger = boxes_velo.copy()
    larger[:, 3:6] *= factor
    larger[:, 2] -= (larger[:, 3] - boxes_velo[:, 3]) / 2
    return larger


def label_places(places: Tensor, boxes: Tensor, ratio: tuple[float, float]) -> Tensor:
    """Which reference points stand for an object: 1, none: 0, neither: -1.

    Args:
        places: (K, L, 3).
        boxes: (K, 7) of each frustum's object, bottom centres.
        ratio: within this share of the object positive, beyond the second share negative; the nearest to the centre is
            positive where none is.

    Returns:
        (K, L) int64.
    """
    off = places - centered(boxes)[:, None, :3]
    cos, sin = boxes[:, 6, None].cos(), boxes[:, 6, None].sin()
    own = torch.stack(
        [off[..., 0] * cos + off[..., 1] * sin, off[..., 1] * cos - off[..., 0] * sin, off[..., 2]],
        dim=-1,
    )
    share = (own.abs() / (boxes[:, None, [5, 4, 3]] / 2)).amax(dim=-1)
    labels = torch.where(share <= ratio[0], 1, torch.where(share <= ratio[1], -1, 0))
    lonely = ~(labels == 1).any(dim=1)
    nearest = off.norm(dim=-1).argmin(dim=1)
    labels[lonely, nearest[lonely]] = 1
    return labels


def by_frame(
    boxes: Tensor,
    scores: Tensor,
    boxes_image: Tensor,
    kinds: Tensor,
    frames: Tensor,
    n_frames: int,
    max_boxes: int,
    min_score: float,
) -> list[Found]:
    """Boxes of each frame, best first, of each class so many: (N, 7) ``boxes_velo``, (N,), (N, 4), (N,), (N,)."""
    rows, values, owner = (
        boxes.double().cpu().numpy(),
        scores.double().cpu().numpy(),
        frames.cpu().numpy(),
    )
    images, classes = boxes_image.double().cpu().numpy(), kinds.cpu().numpy()
    rows[:, 6] = wrap(rows[:, 6])
    found = []
    for frame in range(n_frames):
        is_box = (rows[:, 3:6] > LEAST_SIZE).all(axis=1)
        own: NDArray[np.int64] = np.flatnonzero((owner == frame) & (values >= min_score) & is_box)
        own = own[np.argsort(-values[own], kind="stable")]
        own = own[_first_of_each(classes[own], max_boxes)]
        found.append(Found(rows[own], values[own], images[own], classes[own]))
    return found


def _first_of_each(kinds: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """Which are among the first so many of their class: (N,) -> (N,)."""
    kept = np.zeros(len(kinds), dtype=bool)
    for kind in np.unique(kinds):
        kept[np.flatnonzero(kinds == kind)[:count]] = True
    return kept


def suppressed(found: Found, count: int) -> Found:
    """Of each class the best boxes of a frame that do not overlap a better one."""
    boxes_velo, scores = found.boxes_velo, found.scores
    kinds = np.zeros(len(scores), dtype=np.int64) if found.kinds is None else found.kinds
    parts = [np.zeros(0, dtype=np.int64)]
    for kind in np.unique(kinds):
        own = np.flatnonzero(kinds == kind)
        rectangles, spans = rectangles_velo(boxes_velo[own]), spans_velo(boxes_velo[own])
        parts.append(own[nms(rectangles, scores[own], SUPPRESSED, "3d", count, spans)])
    kept = np.concatenate(parts)
    if len(parts) > 2:
        kept = kept[np.argsort(-scores[kept], kind="stable")]
    return Found(
        boxes_velo[kept],
        scores[kept],
        None if found.boxes_image is None else found.boxes_image[kept],
        kinds[kept],
    )
