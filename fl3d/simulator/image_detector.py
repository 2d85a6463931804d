"""A stand-in for a 2D detector: boxes with the recall, precision, scores and noise of the one shared with KITTI.

The numbers were fitted to the detections of Qi et al. (Frustum PointNets, CVPR 2018; ``rgb_detection_val.txt``) held
against KITTI's val labels at overlap 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fl3d.data.labels import Labels
from fl3d.geometry.iou import image_iou
from fl3d.simulator.solids import Float

NUMBERS = {"Pedestrian": 1, "Car": 2, "Cyclist": 3}  # as the files name classes
LOWEST_SCORE = 0.01
SUPPRESSED = 0.45  # overlap with a better box of its class
LOGITS = np.array(
    [
        np.log(x / (1 - x))
        for x in (0.01, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99, 0.995, 0.999, 0.9998)
    ]
)


@dataclass(frozen=True)
class Model:
    """How one class is detected.

    Args:
        weights: of log height / 40, its part below 0, log height / 25 below 0, occlusion 1, 2, 3, and truncation, in
            the logistic quality of an object.
        missed: share that is never found, by occlusion 0 to 3.
        cuts: quality at which the score reaches ``LOGITS``.
        shift: median of (detected - true) / size of the edges x1, y1, x2, y2.
        noise: of each edge, the logarithm of its scale: constant, log height / 40, occlusion 1, 2, 3, truncation,
            logit of the score - 5.
        tails: degrees of freedom of the edges' noise (Student's t).
        satellites: further boxes per object: parts of it, or it and its neighbour.
        false: boxes a frame where there is nothing.
        false_height: median and spread (logarithmic) of their height in pixels.
        false_aspect: median and spread (logarithmic) of width over height.
    """

    weights: tuple[float, ...]
    missed: tuple[float, ...]
    cuts: tuple[float, ...]
    shift: tuple[float, ...]
    noise: tuple[tuple[float, ...], ...]
    tails: tuple[float, ...]
    satellites: float
    false: float
    false_height: tuple[float, float]
    false_aspect: tuple[float, float]


MODELS = {
    "Car": Model(
        (0.64, 3.02, 3.77, -2.19, -3.94, -2.23, -5.48),
        (0.008, 0.01, 0.156, 0.057),
        (-7.81, -6.9, -6.46, -5.96, -5.64, -5.17, -4.76, -4.12, -3.74, -2.55, -1.95, 0.09, 3.0),
        (-0.005, -0.01, -0.015, -0.009),
        (
            (-3.37, -0.21, 0.23, 0.51, -0.07, -0.45, -0.095),
            (-3.37, -0.3, -0.15, -0.07, 0.11, 0.64, -0.083),
            (-3.52, -0.15, 0.21, 0.59, 0.52, 0.08, -0.093),
            (-3.4, -0.16, 0.05, 0.2, 0.75, -0.93, -0.082),
        ),
        (3.3, 4.7, 4.2, 5.0),
        0.25,
        0.184,
        (30.0, 0.7),
        (1.5, 0.45),
    ),
    "Pedestrian": Model(
        (3.83, -2.26, -3.45, -1.84, -2.97, -2.24, -7.98),
        (0.036, 0.071, 0.307, 0.115),
        (-1.48, -1.12, -0.8, -0.36, -0.04, 0.4, 0.98, 1.77, 2.28, 3.64, 4.55, 6.8, 9.0),
        (-0.056, 0.003, -0.073, -0.009),
        (
            (-2.18, -0.25, 0.16, 0.16, 0.3, 1.58, -0.063),
            (-3.73, -0.06, -0.05, -0.14, 0.05, 0.94, -0.074),
            (-2.18, -0.18, 0.25, 0.03, 0.03, 0.42, -0.025),
            (-3.91, 0.08, 0.47, 1.12, 0.53, -1.71, -0.126),
        ),
        (23.0, 10.0, 15.0, 3.8),
        0.55,
        0.274,
        (44.0, 0.5),
        (0.34, 0.35),
    ),
    "Cyclist": Model(
        (2.84, 3.53, 12.17, -1.77, -3.27, -0.2, -7.8),
        (0.002, 0.401, 0.485, 0.002),
        (-4.15, -3.36, -2.91, -2.37, -2.15, -1.84, -1.42, -0.87, -0.56, 0.23, 0.59, 2.12, 4.0),
        (-0.014, -0.01, -0.015, -0.007),
        (
            (-2.36, -0.07, -0.25, -0.19, -0.09, -0.43, -0.024),
            (-3.19, -0.35, 0.06, 0.29, 0.04, 1.41, -0.018),
            (-2.73, 0.02, 0.08, 0.85, -0.05, 0.2, -0.054),
            (-3.26, -0.63, 0.65, 1.96, 0.38, 0.35, 0.028),
        ),
        (15.0, 11.0, 10.0, 7.6),
        0.45,
        0.187,
        (48.0, 0.55),
        (0.6, 0.55),
    ),
}
# What is taken for another class: of, as, and the middle and spread of its quality there (a logistic distribution).
CONFUSIONS = (
    ("Van", "Car", -7.1, 2.0),
    ("Misc", "Car", -9.6, 1.0),
    ("Truck", "Car", -11.3, 1.0),
    ("Person_sitting", "Pedestrian", -0.25, 1.2),
    ("Cyclist", "Pedestrian", -2.46, 1.0),
    ("Pedestrian", "Cyclist", -4.96, 1.0),
)
IN_DONTCARE = 0.22  # cars found per DontCare region


@dataclass(frozen=True)
class ImageDetections:
    """2D detections of one frame: classes (N,), scores (N,) and boxes (N, 4), whole pixels, not cut at the border."""

    kinds: list[str]
    scores: Float
    boxes: Float


def detect_in_image(
    labels: Labels, image_size: tuple[int, int], rng: np.random.Generator
) -> ImageDetections:
    """What the 2D detector would find.

    Args:
        labels: of the frame.
        image_size: (width, height).
        rng: of every choice.
    """
    found: list[tuple[str, float, Float]] = []
    for k in range(len(labels)):
        kind, box = str(labels.types[k]), labels.boxes_image[k]
        occluded, truncated = int(labels.occluded[k]), float(labels.truncated[k])
        if kind in MODELS:
            found += _detect(MODELS[kind], kind, box, occluded, truncated, None, rng)
            found += _satellites(MODELS[kind], kind, box, rng)
        for other, taken_for, middle, spread in CONFUSIONS:
            if kind == other:
                quality = float(rng.logistic(middle, spread))
                found += _detect(
                    MODELS[taken_for], taken_for, box, occluded, truncated, quality, rng
                )
        if kind == "DontCare" and rng.random() < IN_DONTCARE:
            found.append(("Car", _low_score(0.12, 2.3, rng), box + rng.normal(0, 2, 4)))
    for kind, model in MODELS.items():
        for _ in range(rng.poisson(model.false)):
            found.append((kind, _low_score(0.04, 1.9, rng), _false_box(model, image_size, rng)))
    kept = _suppress(found)
    boxes = np.array([np.rint(box) for _, _, box in kept]).reshape(-1, 4)
    return ImageDetections(
        [kind for kind, _, _ in kept], np.array([score for _, score, _ in kept]), boxes
    )


def _detect(
    model: Model,
    kind: str,
    box: Float,
    occluded: int,
    truncated: float,
    quality: float | None,
    rng: np.random.Generator,
) -> list[tuple[str, float, Float]]:
    size = np.array([box[2] - box[0], box[3] - box[1]])
    tall = np.log(max(size[1], 1.0) / 40)
    level = np.zeros(3)
    if occluded:
        level[occluded - 1] = 1
    if quality is None:
        terms = np.array(
            [tall, min(tall, 0.0), min(tall + np.log(40 / 25), 0.0), *level, truncated]
        )
        quality = float(np.array(model.weights) @ terms) + rng.logistic()
    if rng.random() < model.missed[occluded] or quality < model.cuts[0]:
        return []
    logit = float(np.interp(quality, model.cuts, LOGITS))
    scale = np.array(model.noise) @ np.array([1.0, tall, *level, truncated, logit - 5])
    spread = np.exp(np.clip(scale, -6, -0.7)) * rng.standard_t(np.array(model.tails))
    noise = np.clip(np.array(model.shift) + spread, -0.4, 0.4)
    return [(kind, 1 / (1 + np.exp(-logit)), box + noise * np.tile(size, 2))]


def _satellites(
    model: Model, kind: str, box: Float, rng: np.random.Generator
) -> list[tuple[str, float, Float]]:
    found = []
    for _ in range(rng.poisson(model.satellites)):
        size = np.array([box[2] - box[0], box[3] - box[1]])
        center = (box[:2] + box[2:]) / 2 + size * np.array(
            [rng.normal(0, 0.35), rng.normal(-0.14, 0.13)]
        )
        half = (
            size
            * np.array([0.66 * np.exp(rng.normal(0, 0.35)), 0.75 * np.exp(rng.normal(0, 0.28))])
            / 2
        )
        found.append(
            (kind, _low_score(0.06, 2.0, rng), np.concatenate([center - half, center + half]))
        )
    return found


def _low_score(median: float, spread: float, rng: np.random.Generator) -> float:
    logit = np.log(median / (1 - median)) + spread * rng.normal()
    return float(max(LOWEST_SCORE, 1 / (1 + np.exp(-logit))))


def _false_box(model: Model, image_size: tuple[int, int], rng: np.random.Generator) -> Float:
    """A box that stands on the ground: the lower in the picture, the larger."""
    height = model.false_height[0] * np.exp(model.false_height[1] * rng.normal())
    width = height * model.false_aspect[0] * np.exp(model.false_aspect[1] * rng.normal())
    bottom = 182 + height * 0.75 + rng.normal(0, 10)
    left = rng.uniform(0, image_size[0]) - width / 2
    return np.array([left, bottom - height, left + width, bottom])


def _suppress(found: list[tuple[str, float, Float]]) -> list[tuple[str, float, Float]]:
    kept: list[tuple[str, float, Float]] = []
    for kind, score, box in sorted(found, key=lambda one: -one[1]):
        better = [other for own, _, other in kept if own == kind]
        if not better or image_iou(box[None], np.array(better)).max() <= SUPPRESSED:
            kept.append((kind, score, box))
    return kept
