"""The ground: a gently sloping, gently bent surface with a road on it."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


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
        """(9,) of the road, in the order of its fields."""
        return np.array(astuple(self.road))

    def at(self, x: float, y: float) -> tuple[float, float, float]:
        """Height at a place, and the slopes along x and y there."""
        height = self.height + self.slope_x * x + self.slope_y * y + self.bend * (x * x + y * y)
        return height, self.slope_x + 2 * self.bend * x, self.slope_y + 2 * self.bend * y
