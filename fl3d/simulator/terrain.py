"""The ground: a gently sloping, gently bent surface with a road on it."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.simulator.noise import Float, smooth_noise

# Of a surface that rays meet: metres that a road is uneven over half a metre, over 1.3 and over nine. Along 15 columns
# of a ring on KITTI's roads ranges part from a parabola by 0.74 cm at 5 to 10 m, 1.8 at 20 to 30 and 3.6 beyond, more
# than the sensor's noise.
FINE, MIDDLE, WAVE = 0.007, 0.006, 0.012
VERGE_FINE, VERGE_MIDDLE = 0.12, 0.3  # shares of a land's roughness that such a surface has


@dataclass(frozen=True)
class Road:
    """Where the road runs, y = start + slope x + bend x^2 along its middle line, and what the land beside it is like.

    Args:
        start: metres, at the LiDAR.
        slope: of the line.
        bend: of the line, 1/metres.
        left: metres from the line to the edge on the left.
        right: to the edge on the right, negative.
        rise: metres by which the land beside lies higher, in the mean.
        rough: metres of unevenness that the land has and the road has not.
        origin_x: metres, where this place lies in the unevenness of the whole earth.
        origin_y: likewise.
        field: 1 where unevenness is a surface that rays meet and things stand on, as smooth as KITTI's roads; 0 where
            it lifts points alone, as in the frames of the published results.
    """

    start: float = 0.0
    slope: float = 0.0
    bend: float = 0.0
    left: float = 4.0
    right: float = -4.0
    rise: float = 0.0
    rough: float = 0.0
    origin_x: float = 0.0
    origin_y: float = 0.0
    field: float = 0.0


@dataclass(frozen=True)
class Ground:
    """z = height + slope_x x + slope_y y + bend (x^2 + y^2), in the LiDAR frame, metres.

    Args:
        height: below the LiDAR.
        slope_x: rise to the front.
        slope_y: rise to the left.
        bend: 1/metres; a crest is negative, a dip positive.
        road: on it.
    """

    height: float
    slope_x: float = 0.0
    slope_y: float = 0.0
    bend: float = 0.0
    road: Road = field(default_factory=Road)

    @cached_property
    def coefficients(self) -> NDArray[np.float64]:
        """(4,) height, slope_x, slope_y, bend."""
        return np.array([self.height, self.slope_x, self.slope_y, self.bend])

    @cached_property
    def road_coefficients(self) -> NDArray[np.float64]:
        """(10,) of the road, in the order of its fields."""
        return np.array(astuple(self.road))

    @cached_property
    def even(self) -> Ground:
        """The same without unevenness."""
        return replace(self, road=replace(self.road, field=0.0))

    def at(self, x: float, y: float) -> tuple[float, float, float]:
        """Height at a place, and the slopes along x and y there."""
        height = self.height + self.slope_x * x + self.slope_y * y + self.bend * (x * x + y * y)
        if self.road.field:
            height += bumps(np.array([x, y, height]), self.road_coefficients)
        return height, self.slope_x + 2 * self.bend * x, self.slope_y + 2 * self.bend * y


@numba.njit(cache=True, error_model="numpy")
def bumps(point: Float, road: Float) -> float:
    """Height of the ground's unevenness, metres: worn asphalt on the road, higher and rougher beside it."""
    across = point[1] - road[0] - road[1] * point[0] - road[2] * point[0] * point[0]
    beside = max(0.0, across - road[3], road[4] - across)
    verge = min(1.0, beside / 3)
    x, y = point[0] + road[7], point[1] + road[8]
    broad = smooth_noise(x, y, 9.0)
    wave = road[5] * verge * (0.7 + 0.6 * broad)
    if road[9] > 0:
        rough = road[6] * verge
        return (
            (FINE + VERGE_FINE * rough) * smooth_noise(x, y, 0.5)
            + (MIDDLE + VERGE_MIDDLE * rough) * smooth_noise(x, y, 1.3)
            + wave
            + WAVE * broad
        )
    return (0.02 + road[6] * verge) * smooth_noise(x, y, 1.3) + wave
