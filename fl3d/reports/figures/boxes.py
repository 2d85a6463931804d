"""Figures of frames: boxes from above and on the picture, in the paper's colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fl3d.data.classes import CARS
from fl3d.data.kitti import Frame
from fl3d.data.labels import Labels
from fl3d.geometry.boxes import CORNER_SIGNS, Array, corners_velo
from fl3d.reports.figures.style import BLUE, PURPLE, Drawing, Drawn, canvas, save, styled

FOOTPRINT = (0, 1, 5, 2, 0)  # corners around the bottom face
EDGES = tuple(
    (a, b)
    for a in range(8)
    for b in range(a + 1, 8)
    if np.abs(np.subtract(CORNER_SIGNS[a], CORNER_SIGNS[b])).sum() == 2  # along one axis
)
# Of several classes, dark to light, so that they differ in grey too; lines tell them where boxes are pale.
PURPLES = (PURPLE, "#c04fb0", "#3b1045", "#e49ad8")
BLUES = (BLUE, "#5fb0ff", "#0b2a5c", "#9fd0d8")
LINES: tuple[str | tuple[int, tuple[int, ...]], ...] = ("-", (0, (4, 1)), (0, (1, 1)), "-.")
NEAR = 1.0  # metres: boxes with a corner nearer to the camera are not drawn on the picture


@dataclass(frozen=True)
class Scene:
    """A frame and what a model finds in it.

    Args:
        frame: cloud and labels.
        image: (H, W, 3), or None: points are drawn instead, brighter where nearer.
        found: detections as evaluated.
        classes: that are drawn.
    """

    frame: Frame
    image: NDArray[np.uint8] | None
    found: Labels
    classes: Sequence[str] = CARS


def boxes_of_models(
    models: dict[str, list[Scene]],
    beyond: tuple[float, float, float, float] | None,
) -> Drawn:
    """For each model a row of pictures with projected boxes and a row of the same frames from above.

    Args:
        models: by name, the same frames for each.
        beyond: area of the evaluation, or None.
    """
    n = len(next(iter(models.values())))
    with styled():
        size = (max(4.0, 2.4 * n), 2.9 * max(1.4 if n == 1 else 1.0, len(models)))
        figure, grid = canvas(2 * len(models), n, size, [0.75, 2.1] * len(models))
        for k, (name, scenes) in enumerate(models.items()):
            for column, scene in enumerate(scenes):
                _on_picture(grid[2 * k, column], scene)
                axes = grid[2 * k + 1, column]
                from_above(axes, scene.frame, scene.found, beyond, scene.classes)
                if column:
                    grid[2 * k + 1, column].set(ylabel="", yticks=[])
                if k + 1 < len(models):
                    grid[2 * k + 1, column].set(xlabel="", xticks=[])
            grid[2 * k, 0].set_title(name, loc="left")
        return Drawn(figure)


def draw_picture(axes: Axes, scene: Scene) -> None:
    """The picture, or the cloud as the camera would see it."""
    frame, calibration = scene.frame, scene.frame.calibration
    width, height = frame.image_size
    if scene.image is not None:
        axes.imshow(scene.image, extent=(0, width, height, 0))
    else:
        axes.set_facecolor("black")
        points_cam = calibration.points_to_cam(frame.points_velo)
        pixels, depth = calibration.points_to_image(points_cam)
        axes.scatter(
            pixels[:, 0],
            pixels[:, 1],
            c=1 / np.maximum(depth, 2),
            s=0.05,
            cmap="gray",
            vmin=0,
            vmax=0.2,
            rasterized=True,
        )


def _on_picture(axes: Axes, scene: Scene) -> None:
    draw_picture(axes, scene)
    frame, calibration = scene.frame, scene.frame.calibration
    width, height = frame.image_size
    for drawn in _drawn(frame, scene.found, scene.classes):
        for corners, alpha in zip(corners_velo(drawn.boxes_velo), drawn.strength, strict=True):
            corners_cam = calibration.points_to_cam(corners)
            if corners_cam[:, 2].min() < NEAR:
                continue
            pixels, _ = calibration.points_to_image(corners_cam)
            for edge in EDGES:
                look: dict[str, Any] = {"color": drawn.color, "ls": drawn.line}
                axes.plot(*pixels[list(edge)].T, lw=0.6, alpha=float(alpha), **look)
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[], aspect="equal")


@dataclass(frozen=True)
class _Drawn:
    """Boxes that look alike: (N, 7), their colour and line, and (N,) how strong each is."""

    boxes_velo: Array
    color: str
    line: str | tuple[int, tuple[int, ...]]
    label: str
    strength: Array


def _drawn(frame: Frame, found: Labels, classes: Sequence[str]) -> list[_Drawn]:
    """Ground truth and estimates: of one class purple and blue, of several each in lines and tones of its own."""
    parts = []
    for labels, colors, what in (
        (frame.labels, PURPLES, "ground truth"),
        (found, BLUES, "estimate"),
    ):
        for number, name in enumerate(classes):
            own = labels.select(labels.types == name)
            boxes = frame.calibration.boxes_to_velo(own.boxes_cam)
            strength = np.ones(len(own)) if labels is frame.labels else _strength(own)
            color, line = colors[number % len(colors)], LINES[number % len(LINES)]
            label = what if len(classes) == 1 else f"{what}, {name}"
            parts.append(_Drawn(boxes, color, line, label, strength))
    return parts


def _strength(found: Labels) -> Array:
    """Of a box: the higher its score, the stronger."""
    return np.clip(found.scores if found.scores is not None else np.zeros(0), 0.15, 1)


def birds_eye(
    frame: Frame,
    detections: Labels,
    beyond: tuple[float, float, float, float] | None,
    title: str,
    path: Path,
    classes: Sequence[str] = CARS,
) -> list[Path]:
    """One frame from above: points, objects (purple) and estimates (blue, with scores; the higher the stronger).

    Args:
        frame: cloud and labels.
        detections: as evaluated.
        beyond: area of the evaluation, or None.
        title: above it.
        path: without ending.
        classes: that are drawn.
    """
    with styled():
        figure = Drawing(figsize=(5, 4.6))
        axes = figure.subplots()
        from_above(axes, frame, detections, beyond, classes)
        boxes = frame.calibration.boxes_to_velo(detections.boxes_cam)
        scores = detections.scores if detections.scores is not None else np.zeros(0)
        for box, score, alpha in zip(boxes, scores, _strength(detections), strict=True):
            axes.annotate(
                f"{score:.2f}",
                box[:2],
                fontsize=4,
                color=BLUE,
                ha="center",
                va="center",
                alpha=alpha,
            )
        axes.set_title(title)
        axes.legend(loc="upper left", fontsize=6)
        return save(figure, path, (".png",))  # one for each trial, to look at in MLflow


def from_above(
    axes: Axes,
    frame: Frame,
    found: Labels,
    beyond: tuple[float, float, float, float] | None,
    classes: Sequence[str] = CARS,
) -> None:
    """Draw points, objects and estimates of a frame in the plane of the ground."""
    points = frame.points_velo
    axes.scatter(points[:, 0], points[:, 1], s=0.15, c="0.55", linewidths=0, rasterized=True)
    for drawn in _drawn(frame, found, classes):
        look: dict[str, Any] = {"color": drawn.color, "ls": drawn.line, "lw": 1.0}
        axes.plot([], [], label=drawn.label, **look)
        for corners, alpha in zip(corners_velo(drawn.boxes_velo), drawn.strength, strict=True):
            axes.plot(*corners[list(FOOTPRINT), :2].T, alpha=float(alpha), **look)
    x0, y0, x1, y1 = beyond or (0, -40, 70.4, 40)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x (m)", ylabel="y (m)")
