"""KITTI's left colour camera on the car, and the picture it takes of a scene."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.data.calibration import Calibration
from fl3d.data.kitti import IMAGE_SIZE
from fl3d.simulator.light import (
    GLASS_NUMBER,
    cast_shadows,
    ground_color,
    sky_color,
    solid_color,
    speckle,
)
from fl3d.simulator.materials import DENSITY, GRASS, PAVING, TABLE
from fl3d.simulator.noise import chance
from fl3d.simulator.solids import FLAT, MATERIAL, PASS, Float, Solids, enter_solid, hit_ground
from fl3d.simulator.terrain import Ground

Image = NDArray[np.uint8]

# The calibration of four fifths of KITTI's frames.
CALIBRATION = Calibration(
    P2=np.array(
        [
            [721.5377, 0, 609.5593, 44.85728],
            [0, 721.5377, 172.854, 0.2163791],
            [0, 0, 1, 0.002745884],
        ]
    ),
    R0_rect=np.array(
        [
            [0.999924, 0.009838, -0.007445],
            [-0.00987, 0.999942, -0.004278],
            [0.007403, 0.004352, 0.999963],
        ]
    ),
    Tr_velo_to_cam=np.array(
        [
            [0.007534, -0.999971, -0.000617, -0.00407],
            [0.014802, 0.000728, -0.99989, -0.076316],
            [0.999862, 0.007524, 0.014808, -0.271781],
        ]
    ),
)
# The other cameras, and the inertial unit, of the same car: fl3d uses none of them, other tools may.
_K = CALIBRATION.P2[:, :3]
OTHERS = {
    "P0": np.column_stack([_K, [0.0, 0.0, 0.0]]),
    "P1": np.column_stack([_K, [-387.5744, 0.0, 0.0]]),
    "P3": np.column_stack([_K, [-339.5242, 2.199936, 0.002729905]]),
    "Tr_imu_to_velo": np.array(
        [
            [0.9999976, 0.0007553071, -0.002035826, -0.8086759],
            [-0.0007854027, 0.9998898, -0.01482298, 0.3195559],
            [0.002024406, 0.01482454, 0.9998881, -0.7997231],
        ]
    ),
}
_TONES = (255 * np.linspace(0, 1, 2048) ** 0.8).astype(np.uint8)  # of a camera's film
WIDEST = (
    1.4  # a little more than 1 / cos of the angle between the optical axis and the picture's border
)
HAZE = 160.0  # metres, after which a third of a colour is left


def take_picture(solids: Solids, ground: Ground, rng: np.random.Generator) -> Image:
    """Render a scene: (height, width, 3).

    Args:
        solids: of the scene.
        ground: below.
        rng: where the sun stands and how bright the day is.
    """
    azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(25, 60))
    sun = np.array(
        [np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)]
    )
    matrix = CALIBRATION.P2[:, :3] @ CALIBRATION.velo_to_rect
    matrix[:, 3] += CALIBRATION.P2[:, 3]
    to_velo = np.linalg.inv(matrix[:, :3])
    center = -to_velo @ matrix[:, 3]
    shadows = cast_shadows(
        solids.planes, solids.counts, solids.corners, solids.parts, ground.coefficients, sun, TABLE
    )
    brightness = rng.uniform(0.85, 1.1)
    return _render(
        np.array([IMAGE_SIZE[1], IMAGE_SIZE[0]]),
        matrix,
        to_velo,
        center,
        solids.planes,
        solids.counts,
        solids.corners,
        solids.nearest,
        solids.parts,
        ground.coefficients,
        ground.road_coefficients,
        shadows,
        sun,
        brightness,
        TABLE,
        np.array([GRASS.color, PAVING.color]),
        _TONES,
    )


@numba.njit(cache=True, error_model="numpy")
def _render(
    size: NDArray[np.int64],
    matrix: Float,
    to_velo: Float,
    center: Float,
    planes: Float,
    counts: NDArray[np.int64],
    corners: Float,
    nearest: Float,
    parts: Float,
    ground: Float,
    road: Float,
    shadows: NDArray[np.uint8],
    sun: Float,
    brightness: float,
    table: Float,
    land: Float,
    tones: Image,
) -> Image:
    height, width = size
    depth = np.full((height, width), 1e9, dtype=np.float32)
    which = np.full((height, width), -1, dtype=np.int32)
    through = np.zeros((height, width), dtype=np.int8)
    d, point, color = np.zeros(3), np.zeros(3), np.zeros(3)
    for s in range(len(counts)):
        top, bottom, left, right = _extent(matrix, corners[s], height, width)
        material = int(parts[s, MATERIAL])
        density = table[material, DENSITY]
        see_through = 0.0 if material == GLASS_NUMBER else parts[s, PASS]
        for v in range(top, bottom):
            for u in range(left, right):
                if depth[v, u] * WIDEST < nearest[s] - 0.5:
                    continue  # hidden; near solids come first
                _direction(to_velo, u, v, d)
                enter, leave, plane = enter_solid(planes[s], counts[s], center, d)
                if enter >= leave or enter <= 0 or enter >= depth[v, u]:
                    continue
                if density > 0:
                    for axis in range(3):
                        point[axis] = center[axis] + enter * d[axis]
                    length = (leave - enter) * np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
                    if speckle(point, s) > 1 - np.exp(-density * length):
                        continue
                elif see_through > 0 and abs(planes[s, plane, 2]) < FLAT:
                    for axis in range(3):
                        point[axis] = center[axis] + enter * d[axis]
                    if chance(5, int(np.floor((point[0] + point[1]) * 12)), s) < see_through:
                        continue
                depth[v, u], which[v, u], through[v, u] = enter, s, plane
    image = np.empty((height, width, 3), dtype=np.uint8)
    for v in range(height):
        for u in range(width):
            _direction(to_velo, u, v, d)
            t, s = float(depth[v, u]), which[v, u]
            low = hit_ground(ground, center, d)
            if low < t:
                t, s = low, -2
            for axis in range(3):
                point[axis] = center[axis] + t * d[axis]
            if t > 1e8:
                sky_color(d, color)
            elif s == -2:
                ground_color(point, road, shadows, land, sun, color)
            else:
                solid_color(
                    point,
                    s,
                    planes[s],
                    counts[s],
                    int(through[v, u]),
                    parts[s],
                    table,
                    sun,
                    d,
                    color,
                )
            if t < 1e8:
                clear = np.exp(-np.hypot(point[0], point[1]) / HAZE)
                for k in range(3):
                    color[k] = color[k] * clear + (0.78 + 0.03 * k) * (1 - clear)
            for k in range(3):
                image[v, u, k] = tones[
                    int((len(tones) - 1) * min(1.0, max(0.0, color[k] * brightness)))
                ]
    return image


@numba.njit(cache=True, error_model="numpy")
def _extent(matrix: Float, corners: Float, height: int, width: int) -> tuple[int, int, int, int]:
    """Rows and columns of the picture that a solid may cover."""
    top, bottom, left, right = 1e9, -1e9, 1e9, -1e9
    behind = 0
    for k in range(len(corners)):
        x, y, z = corners[k]
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if w < 0.2:
            behind += 1
            continue
        u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / w
        v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / w
        top, bottom, left, right = min(top, v), max(bottom, v), min(left, u), max(right, u)
    if behind == len(corners):
        return 0, 0, 0, 0
    if behind > 0:  # it reaches past the camera: to whichever border it is near
        middle_u, middle_v = (left + right) / 2, (top + bottom) / 2
        left, right = (-1.0, right) if middle_u < width / 2 else (left, width + 1.0)
        top, bottom = min(top, 0.0 if middle_v < height / 3 else top), height + 1.0
        top = 0.0
    first, last = max(0, int(np.floor(top))), min(height, int(np.ceil(bottom)) + 1)
    return first, last, max(0, int(np.floor(left))), min(width, int(np.ceil(right)) + 1)


@numba.njit(cache=True, error_model="numpy", inline="always")
def _direction(to_velo: Float, u: int, v: int, d: Float) -> None:
    for axis in range(3):
        d[axis] = to_velo[axis, 0] * u + to_velo[axis, 1] * v + to_velo[axis, 2]
