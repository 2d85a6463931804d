"""The Velodyne HDL-64E on KITTI's car, as its 32 sample clouds tell it: 64 lasers in two blocks, ten turns a second."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# Elevation of each laser in degrees: the straight lines that the rings of KITTI's 32 sample clouds lie on, to 0.01.
ELEVATIONS = np.array(
    [
        *(
            1.94,
            1.57,
            1.30,
            0.87,
            0.58,
            0.18,
            -0.09,
            -0.45,
            -0.80,
            -1.20,
            -1.49,
            -1.83,
            -2.21,
            -2.55,
            -2.87,
            -3.24,
        ),
        *(
            -3.54,
            -3.94,
            -4.22,
            -4.59,
            -4.91,
            -5.25,
            -5.61,
            -5.96,
            -6.33,
            -6.68,
            -7.00,
            -7.29,
            -7.68,
            -8.06,
            -8.31,
        ),
        *(
            -8.71,
            -9.03,
            -9.57,
            -10.06,
            -10.47,
            -10.96,
            -11.60,
            -12.12,
            -12.56,
            -13.04,
            -13.48,
            -14.05,
            -14.60,
            -15.19,
        ),
        *(
            -15.66,
            -16.18,
            -16.55,
            -17.19,
            -17.73,
            -18.32,
            -18.80,
            -19.32,
            -19.74,
            -20.22,
            -20.79,
            -21.32,
            -21.94,
        ),
        *(-22.44, -22.86, -23.32, -23.97, -24.51, -25.00),
    ]
)
# Azimuth of each laser against the housing's, degrees.
ROTATIONS = np.array(
    [
        *(
            1.49,
            -0.78,
            -2.77,
            -5.00,
            5.05,
            2.80,
            0.71,
            -1.54,
            -3.52,
            -5.77,
            5.75,
            3.50,
            1.54,
            -0.76,
            -2.75,
            -5.00,
        ),
        *(
            4.99,
            2.75,
            0.75,
            -1.50,
            -3.51,
            -5.76,
            5.79,
            3.55,
            1.54,
            -0.72,
            -2.88,
            -4.98,
            5.04,
            2.80,
            0.77,
            -1.49,
        ),
        *(
            2.23,
            -1.00,
            -4.26,
            -7.62,
            7.69,
            4.44,
            1.12,
            -2.27,
            -5.47,
            -8.90,
            9.02,
            5.63,
            2.36,
            -1.06,
            -4.34,
            -7.77,
        ),
        *(
            7.95,
            4.46,
            1.19,
            -2.29,
            -5.60,
            -9.07,
            9.28,
            5.87,
            2.50,
            -1.05,
            -4.46,
            -7.91,
            8.22,
            4.65,
            1.24,
            -2.28,
        ),
    ]
)
# Where the beams leave the housing: metres above the origin of either block, and to the side, alternating.
ORIGINS = np.concatenate([np.linspace(0.209, 0.198, 32), np.linspace(0.126, 0.116, 32)])
SIDEWAYS = np.where(np.arange(64) % 2 == 0, 0.026, -0.026)
ENCODER = 0.09  # degrees, of the housing's encoder
FIRING = 1.856  # encoder counts between two firings, in the mean
CAMERA_VIEW = 41.0  # degrees to either side: a little more than the camera sees
CAMERA_LASERS = 48  # the lasers below look under the camera's view
# Where the own car's roof and its rack stand before the beams: first laser, and azimuths from and to, degrees.
BLIND = ((57, 0.0, 15.0), (53, 165.0, 180.0))
MIN_RANGE, MAX_RANGE = 2.0, 80.0  # metres; the laser reaches 120, KITTI's clouds end at 80
RANGE_NOISE = 0.009  # metres, one standard deviation


def ray_azimuths(half_view: float, n_rows: int, rng: np.random.Generator) -> Float:
    """Azimuth of each ray in radians, (rows, columns), rising. The encoder counts in whole steps."""
    spare = 9.5 if half_view < 180 else 0.0  # degrees: the lasers look to the side of the housing
    n_columns = int(2 * (half_view + spare) / (ENCODER * FIRING))
    counts = np.floor(FIRING * np.arange(n_columns) + rng.random())
    return np.deg2rad(ENCODER * counts - half_view - spare + ROTATIONS[:n_rows, None])


@numba.njit(cache=True, error_model="numpy", inline="always")
def ray(
    row: int,
    column: int,
    cos_az: Float,
    sin_az: Float,
    cos_el: Float,
    sin_el: Float,
    heights: Float,
    sideways: Float,
    o: Float,
    d: Float,
) -> None:
    """Fill in where a ray begins (o) and where it goes (d, of length 1)."""
    c, s = cos_az[row, column], sin_az[row, column]
    o[0], o[1], o[2] = -sideways[row] * s, sideways[row] * c, heights[row]
    d[0], d[1], d[2] = cos_el[row] * c, cos_el[row] * s, sin_el[row]


@numba.njit(cache=True, error_model="numpy", inline="always")
def is_blind(row: int, azimuth: float) -> bool:
    """Whether the own car stands before a beam."""
    side = abs(np.rad2deg(azimuth))
    side = min(side, 360 - side)
    blind = False
    for first, low, high in BLIND:
        blind |= row >= first and low <= side <= high
    return blind
