"""Figures of where detectors differ: what they find by distance and the like, and frames from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fl3d.geometry.boxes import Array, rectangles_cam
from fl3d.reports.figures.style import (
    BLUE,
    COLUMN,
    ORANGE,
    PURPLE,
    Drawn,
    canvas,
    panels,
    save,
    shades,
    styled,
)

SPREAD = 0.3  # of the marks of one bin, as a share of the room between bins
GREY = "0.65"
AHEAD, ASIDE = 20.0, 12.0  # metres that a drawing shows at least
MARGIN = 4.0  # metres around what is drawn
WIDEST, NARROWEST = 1.6, 0.9  # of a drawing, its width over its height


def draw_found_by_part(data: pd.DataFrame, names: Sequence[str], path: Path) -> list[Path]:
    """Share of objects found by each detector, a panel for each way to tell objects apart.

    Args:
        data: see ``analysis.differences.found_by_part``, of one class.
        names: of the detectors, in order.
        path: without ending.
    """

    def panel(axes: Axes, by: str) -> None:
        own = data[(data["by"] == by) & (data["n_gt"] > 0)]
        bins = list(dict.fromkeys(own["bin"]))
        looks = [look for look in shades(names) if look[0] in set(own["detector"])]
        shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(looks)) if len(looks) > 1 else [0.0]
        for (name, (color, marker)), shift in zip(looks, shifts, strict=True):
            mine = own[own["detector"] == name].set_index("bin").loc[bins]
            ends = np.maximum(
                0, [mine["found"] - mine["found_low"], mine["found_high"] - mine["found"]]
            )
            look: Any = {"color": color, "marker": marker, "ms": 4, "ls": "", "elinewidth": 1}
            axes.errorbar(np.arange(len(bins)) + shift, mine["found"], ends, label=name, **look)
        counts = own.groupby("bin", sort=False)["n_gt"].first().loc[bins]
        ticks = [f"{name}\n{count}" for name, count in zip(bins, counts, strict=True)]
        axes.set_xticks(np.arange(len(bins)), ticks, fontsize=6)
        axes.set_xlim(-0.6, len(bins) - 0.4)
        axes.set_ylim(-3, 100)
        axes.set_ylabel("found (%)")
        axes.grid(axis="y", color="0.92", lw=0.6)
        axes.set_axisbelow(True)

    return Drawn(panels(list(dict.fromkeys(data["by"])), panel, 4, 2.5), data).write(path)


@dataclass(frozen=True)
class Seen:
    """What one detector finds in a frame.

    Args:
        gt_cam: (G, 7) boxes of ground truths.
        found: (G,) 1 found, 0 missed, -1 neither.
        det_cam: (D, 7) boxes of its detections above the cut.
        alarm: (D,) which of them are false alarms.
        hit: (D,) which find an object.
        points_cam: (P, 3) of the cloud, or None.
        image: (H, W, 3), or None.
        boxes_image: (D, 4) of the detections.
    """

    gt_cam: Array
    found: NDArray[np.int8]
    det_cam: Array
    alarm: NDArray[np.bool_]
    hit: NDArray[np.bool_]
    points_cam: Array | None = None
    image: NDArray[np.uint8] | None = None
    boxes_image: Array | None = None


def frames_from_above(
    frames: Sequence[tuple[str, Sequence[Seen]]], names: Sequence[str], path: Path
) -> list[Path]:
    """Frames side by side, a row a detector: from above, and in the picture where there is one.

    Args:
        frames: title of each, and what each detector finds in it.
        names: of the detectors.
        path: without ending.
    """
    has_pictures = any(one.image is not None for _, row in frames for one in row)
    heights = ([0.3, 1.0] if has_pictures else [1.0]) * len(names)
    per = len(heights) // len(names)
    width = 2 * COLUMN
    side, behind, ahead = _extent([one for _, row in frames for one in row])
    tall = width / len(frames) * (ahead - behind) / (2 * side) * 0.95
    with styled():
        size = (width, tall * sum(heights) + 0.7)
        figure, grid = canvas(len(heights), len(frames), size, heights)
        for column, (title, row) in enumerate(frames):
            grid[0, column].set_title(title, fontsize=7)
            for number, (name, one) in enumerate(zip(names, row, strict=True)):
                below = grid[per * number + per - 1, column]
                _draw(below, one)
                below.set(xlim=(-side, side), ylim=(behind, ahead), aspect="equal")
                if has_pictures:
                    _picture(grid[per * number, column], one)
                if column == 0:
                    below.set_ylabel(f"{name}\nahead (m)", fontsize=7)
                else:
                    below.set_yticklabels([])
                below.tick_params(labelsize=6)
                if number + 1 < len(names):
                    below.set_xticklabels([])
                else:
                    below.set_xlabel("to the right (m)", fontsize=7)
        handles, labels = grid[per - 1, 0].get_legend_handles_labels()
        look: Any = {"fontsize": 7, "frameon": False, "loc": "outside lower center"}
        figure.legend(handles, labels, ncols=len(labels), **look)
        return save(figure, path)


def _extent(seen: Sequence[Seen]) -> tuple[float, float, float]:
    """How far to either side the drawings reach, and from where behind the camera to where ahead of it."""
    boxes = [one.gt_cam[one.found >= 0] for one in seen]
    boxes += [one.det_cam[one.hit | one.alarm] for one in seen]
    every = np.concatenate(boxes) if boxes else np.zeros((0, 7))
    if not len(every):
        return ASIDE, 0.0, AHEAD
    side = max(ASIDE, float(np.abs(every[:, 0]).max()) + MARGIN)
    ahead = max(AHEAD, float(every[:, 2].max()) + MARGIN)
    nearest = float(every[:, 2].min())
    behind = nearest - MARGIN if nearest < 0 else 0.0
    height = max(ahead - behind, 2 * side / WIDEST)
    return max(side, NARROWEST * height / 2), behind, behind + height


def _draw(axes: Axes, one: Seen) -> None:
    if one.points_cam is not None:
        x, z = one.points_cam[:, 0], one.points_cam[:, 2]
        axes.scatter(x, z, s=0.1, c="0.75", linewidths=0, rasterized=True)
    others = ~one.hit & ~one.alarm
    layers: tuple[tuple[str, Array, Any], ...] = (
        ("not counted", one.gt_cam[one.found < 0], {"color": GREY, "lw": 0.6}),
        ("", one.det_cam[others], {"color": GREY, "lw": 0.6, "ls": ":"}),
        ("object, found", one.gt_cam[one.found == 1], {"color": PURPLE, "lw": 2.4, "alpha": 0.45}),
        ("object, missed", one.gt_cam[one.found == 0], {"color": PURPLE, "lw": 1.2, "ls": (0, (2, 1.2))}),
        ("detection", one.det_cam[one.hit], {"color": BLUE, "lw": 0.9}),
        ("false alarm", one.det_cam[one.alarm], {"color": ORANGE, "lw": 1.2}),
    )  # fmt: skip
    for label, boxes, look in layers:
        if label:
            axes.plot([], [], label=label, **look)
        for outline in _outlines(boxes):
            axes.plot(*outline.T, **look)


def _outlines(boxes_cam: Array) -> Array:
    """Footprints with a stroke from the middle to the front: (N, 7) -> (N, 7, 2) x and z of a line."""
    x, z, length, width, angle = rectangles_cam(boxes_cam).T[..., None]
    along = np.array([0.0, 0.5, 0.5, -0.5, -0.5, 0.5, 0.5])
    across = np.array([0.0, 0.0, 0.5, 0.5, -0.5, -0.5, 0.0])
    a, b = length * along, width * across
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([x + a * cos - b * sin, z + a * sin + b * cos], axis=-1)


def _picture(axes: Axes, one: Seen) -> None:
    axes.set(xticks=[], yticks=[])
    if one.image is None or one.boxes_image is None:
        axes.set_axis_off()
        return
    height, width = one.image.shape[:2]
    axes.imshow(one.image, extent=(0, width, height, 0))
    for mask, color in ((one.hit, BLUE), (one.alarm, ORANGE)):
        for x1, y1, x2, y2 in one.boxes_image[mask]:
            axes.plot([x1, x2, x2, x1, x1], [y1, y1, y2, y2, y1], color=color, lw=0.8)
    axes.set(xlim=(0, width), ylim=(height, 0))
