"""One frame with its labels, to see whether cloud, boxes and picture fit."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fl3d.data.kitti import Frame
from fl3d.geometry.boxes import Array, corners_velo
from fl3d.reports.figures.boxes import EDGES, FOOTPRINT, NEAR
from fl3d.reports.figures.style import BLUE, ORANGE, PURPLE, canvas, styled

MOST_POINTS = 30_000  # drawn from above; more look the same
LEAST_SIDE, MOST_SIDE = 20.0, 120.0  # metres shown on either side of the sensor
DEPTHS = (2.0, 60.0)  # metres: nearest and farthest colour


def draw_frame(
    frame: Frame,
    cloud_velo: NDArray[np.float32],
    image: NDArray[np.uint8] | None,
    wanted: NDArray[np.bool_],
    title: str,
) -> Figure:
    """The picture with boxes and points on it; below, the whole cloud from above.

    Args:
        frame: calibration and labels.
        cloud_velo: (N, 4) the whole cloud, not cropped.
        image: (H, W, 3), or None.
        wanted: (L,) which labels are targets.
        title: above it.
    """
    with styled():
        figure, grid = canvas(2, 1, (7, 8.2), [1, 2.2])
        top, bottom = grid[:, 0]
        real = frame.labels.select(frame.labels.types != "DontCare")
        whole = (real.boxes_cam[:, 3:6] > 0).all(axis=1)
        boxes = frame.calibration.boxes_to_velo(real.boxes_cam[whole])
        colors = [
            PURPLE if is_wanted else ORANGE
            for is_wanted in wanted[frame.labels.types != "DontCare"][whole]
        ]
        _picture(top, frame, cloud_velo, image, boxes, colors)
        _above(bottom, cloud_velo, boxes, [str(name) for name in real.types[whole]], colors)
        figure.suptitle(title, fontsize=8)
    return figure


def _picture(
    axes: Axes,
    frame: Frame,
    cloud_velo: NDArray[np.float32],
    image: NDArray[np.uint8] | None,
    boxes_velo: Array,
    colors: list[str],
) -> None:
    """What the camera sees: points by depth, 3D boxes, and the labels' 2D boxes dashed."""
    calibration, (width, height) = frame.calibration, frame.image_size
    if image is None:
        axes.set_facecolor("black")
    else:
        axes.imshow(image // 2, extent=(0, width, height, 0))
    pixels, depth = calibration.points_to_image(calibration.points_to_cam(cloud_velo))
    before = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
    tone = np.log(np.clip(depth[before], *DEPTHS))
    axes.scatter(
        pixels[before, 0],
        pixels[before, 1],
        c=tone,
        s=0.2,
        cmap="turbo_r",
        linewidths=0,
        rasterized=True,
    )
    for x1, y1, x2, y2 in frame.labels.boxes_image[frame.labels.types != "DontCare"]:
        axes.plot([x1, x2, x2, x1, x1], [y1, y1, y2, y2, y1], color="white", lw=0.6, ls="--")
    for corners, color in zip(corners_velo(boxes_velo), colors, strict=True):
        corners_cam = calibration.points_to_cam(corners)
        if corners_cam[:, 2].min() > NEAR:
            on_image, _ = calibration.points_to_image(corners_cam)
            for edge in EDGES:
                axes.plot(*on_image[list(edge)].T, color=color, lw=0.8)
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[], aspect="equal")
    axes.set_xlabel(
        "through the calibration: points by depth, 3D boxes; dashed: the labels' 2D boxes"
    )


def _above(
    axes: Axes,
    cloud_velo: NDArray[np.float32],
    boxes_velo: Array,
    names: list[str],
    colors: list[str],
) -> None:
    """The cloud and the boxes in the plane of the ground, with the LiDAR's axes."""
    points = cloud_velo[:: max(1, len(cloud_velo) // MOST_POINTS)]
    axes.scatter(points[:, 0], points[:, 1], s=0.2, c="0.55", linewidths=0, rasterized=True)
    for corners, name, color in zip(corners_velo(boxes_velo), names, colors, strict=True):
        axes.plot(*corners[list(FOOTPRINT), :2].T, color=color, lw=1.2)
        x, y = corners[corners[:, 0].argmax(), :2]
        axes.annotate(name, (float(x), float(y)), fontsize=5, color=color)
    for x, y, _, _, _, length, yaw in boxes_velo:
        to = x + length * np.cos(yaw), y + length * np.sin(yaw)
        axes.plot([x, to[0]], [y, to[1]], color="0.2", lw=0.8)  # where it is heading
    side = _side(points, boxes_velo)
    for name, to in (("x", (1, 0)), ("y", (0, 1))):
        end = to[0] * side / 6, to[1] * side / 6
        axes.annotate("", end, (0, 0), arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 1.5})
        axes.annotate(name, end, color=BLUE, fontsize=9, weight="bold")
    for color, label in ((PURPLE, "target"), (ORANGE, "other label")):
        axes.plot([], [], color=color, label=label)
    axes.legend(loc="upper right", fontsize=7)
    axes.set(
        xlim=(-side, side),
        ylim=(-side, side),
        aspect="equal",
        xlabel="x (m), the LiDAR's",
        ylabel="y (m)",
    )


def _side(points: NDArray[np.float32], boxes_velo: Array) -> float:
    """Metres that are worth showing."""
    places = np.concatenate([points[:, :2].astype(np.float64), boxes_velo[:, :2]])
    if not len(places):
        return LEAST_SIDE
    return float(np.clip(np.percentile(np.abs(places).max(axis=1), 99), LEAST_SIDE, MOST_SIDE))
