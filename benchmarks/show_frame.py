"""Look at a frame of any KITTI folder that has pictures: labels above, the cloud below.

    python -m fl3d simulate OUT --frames 24 --seed 21
    python benchmarks/show_frame.py OUT 000002 simulated_frame.png

Boxes are green where visible, yellow partly, red largely occluded, white unknown; points by depth,
near ones blue.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw

from fl3d.data.kitti import Frame, KittiFolder
from fl3d.geometry.boxes import CORNER_SIGNS, corners_velo

OCCLUDED = ("lime", "yellow", "red", "white")
EDGES = [
    (a, b) for a in range(8) for b in range(a) if (CORNER_SIGNS[a] != CORNER_SIGNS[b]).sum() == 1
]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("frame")
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    folder = KittiFolder(arguments.folder)
    frame = folder.frame(arguments.frame)
    picture = Image.open(folder.path("image_2", frame.id)).convert("RGB")
    cloud = draw_cloud(picture, frame)
    draw_labels(picture, frame)
    both = Image.fromarray(np.concatenate([np.array(picture), cloud]))
    both.resize((both.width * 3 // 4, both.height * 3 // 4), Image.Resampling.LANCZOS).quantize(
        200
    ).save(arguments.out, optimize=True)


def draw_labels(picture: Image.Image, frame: Frame) -> None:
    """Draw the 3D boxes of all objects that stand before the camera."""
    canvas = ImageDraw.Draw(picture)
    calibration, labels = frame.calibration, frame.labels
    labels = labels.select(labels.types != "DontCare")
    for occluded, corners in zip(
        labels.occluded, corners_velo(calibration.boxes_to_velo(labels.boxes_cam)), strict=True
    ):
        pixels, depth = calibration.points_to_image(calibration.points_to_cam(corners))
        if depth.min() > 0.3:
            for a, b in EDGES:
                canvas.line([tuple(pixels[a]), tuple(pixels[b])], fill=OCCLUDED[occluded], width=2)


def draw_cloud(picture: Image.Image, frame: Frame) -> np.ndarray:
    """The picture, dimmed, with the points on it."""
    dim = (np.array(picture) * 0.35).astype(np.uint8)
    calibration = frame.calibration
    pixels, depth = calibration.points_to_image(calibration.points_to_cam(frame.points_velo))
    colors = (matplotlib.colormaps["turbo"](np.clip(depth / 50, 0, 1))[:, :3] * 255).astype(
        np.uint8
    )
    u, v = pixels.astype(int).T
    for shift in (0, 1):
        dim[np.clip(v, 0, picture.height - 1), np.clip(u + shift, 0, picture.width - 1)] = colors
    return dim


if __name__ == "__main__":
    main()
