"""KITTI calibration: from the LiDAR to the rectified camera to the image, and boxes between the frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.geometry.boxes import Array, Points, wrap


@dataclass(frozen=True)
class Calibration:
    """One frame's calibration.

    Args:
        P2: (3, 4) projection of rectified camera points into the left colour image.
        R0_rect: (3, 3) rectifying rotation.
        Tr_velo_to_cam: (3, 4) LiDAR to (unrectified) camera.
    """

    P2: NDArray[np.float64]
    R0_rect: NDArray[np.float64]
    Tr_velo_to_cam: NDArray[np.float64]

    @property
    def velo_to_rect(self) -> NDArray[np.float64]:
        """(3, 4): LiDAR to rectified camera."""
        return self.R0_rect @ self.Tr_velo_to_cam

    def points_to_cam(self, points_velo: Points) -> Array:
        """(N, >=3) LiDAR -> (N, 3) rectified camera."""
        m = self.velo_to_rect
        return points_velo[:, :3] @ m[:, :3].T + m[:, 3]

    def points_to_velo(self, points_cam: Array) -> Array:
        """(N, 3) rectified camera -> (N, 3) LiDAR."""
        m = self.velo_to_rect
        return (points_cam - m[:, 3]) @ np.asarray(np.linalg.inv(m[:, :3]).T, dtype=np.float64)

    def points_to_image(self, points_cam: Array) -> tuple[Array, Array]:
        """(N, 3) rectified camera -> (N, 2) pixels and (N,) depth in metres."""
        homogeneous = points_cam @ self.P2[:, :3].T + self.P2[:, 3]
        depth = homogeneous[:, 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return homogeneous[:, :2] / safe[:, None], depth

    def boxes_to_velo(self, boxes_cam: Array) -> Array:
        """``boxes_cam`` (N, 7) -> ``boxes_velo`` (N, 7); the heading is -ry - pi/2."""
        centers = self.points_to_velo(boxes_cam[:, :3])
        return np.column_stack([centers, boxes_cam[:, 3:6], wrap(-boxes_cam[:, 6] - np.pi / 2)])

    def boxes_to_cam(self, boxes_velo: Array) -> Array:
        """``boxes_velo`` (N, 7) -> ``boxes_cam`` (N, 7)."""
        centers = self.points_to_cam(boxes_velo)
        return np.column_stack([centers, boxes_velo[:, 3:6], wrap(-boxes_velo[:, 6] - np.pi / 2)])

    def in_image(self, points_velo: Points, image_size: tuple[int, int]) -> NDArray[np.bool_]:
        """Which LiDAR points project into an image of ``(width, height)`` pixels: (N,)."""
        pixels, depth = self.points_to_image(self.points_to_cam(points_velo))
        width, height = image_size
        inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
        return inside & (depth > 0)


# The mean over KITTI's training set, with which the paper's code converts every frame (`calibration: mean`).
MEAN = Calibration(
    P2=np.array(
        [
            [719.787081, 0.0, 608.463003, 44.9538775],
            [0.0, 719.787081, 174.545111, 0.1066855],
            [0.0, 0.0, 1.0, 3.0106472e-3],
        ]
    ),
    R0_rect=np.array(
        [
            [0.99992475, 9.75976e-3, -7.34152e-3],
            [-9.7913e-3, 0.99994262, -4.30371e-3],
            [7.29911e-3, 4.3753e-3, 0.99996319],
        ]
    ),
    Tr_velo_to_cam=np.array(
        [
            [7.49916597e-3, -0.999971248, -8.65110297e-4, -6.71807577e-3],
            [1.18652889e-2, 9.54520517e-4, -0.999910318, -7.33152811e-2],
            [0.999882833, 7.49141178e-3, 1.18719929e-2, -0.278557062],
        ]
    ),
)

# Of folders without a camera (`calibration: axes`): the LiDAR's axes renamed, x right, y down, z forward. The picture
# has KITTI's focal length and 1242 x 375 pixels, with the LiDAR as its eye and its axis in the middle.
AXES = Calibration(
    P2=np.array([[721.5377, 0.0, 621.0, 0.0], [0.0, 721.5377, 187.5, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    R0_rect=np.eye(3),
    Tr_velo_to_cam=np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0]]),
)
