"""A place under construction: a road over a ground, what stands on it, and where there is room.

Things are placed in road coordinates: ``along`` the road from the LiDAR, ``across`` to its left, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.simulator import people, vehicles
from fl3d.simulator.solids import Float, Parts, Solids
from fl3d.simulator.terrain import Ground

Size = tuple[float, float, float]  # length, width, height
PIECE = 5.0  # metres: fences, walls and banks come in pieces of this length
FAR = 95.0  # metres: nothing is placed beyond
_ROOM = 2048  # footprints that are remembered


@dataclass(frozen=True)
class Kind:
    """A class of KITTI's labels.

    Args:
        mean: height, width, length in metres over KITTI's train split.
        spread: their standard deviations.
        correlation: of height with width, height with length, and width with length.
        make: its parts, for a size.
        inset: metres by which the body is shorter, narrower and lower than its box: means, and standard deviations.
        lift: metres from the ground to the box's bottom.
    """

    mean: tuple[float, float, float]
    spread: tuple[float, float, float]
    correlation: tuple[float, float, float]
    make: Callable[[Size, np.random.Generator], Parts]
    inset: tuple[Size, Size] | None = None
    lift: float = 0.0

    def draw(self, rng: np.random.Generator) -> Size:
        """A size: length, width, height."""
        hw, hl, wl = self.correlation
        root = np.linalg.cholesky(np.array([[1, hw, hl], [hw, 1, wl], [hl, wl, 1]]))
        h, w, length = np.array(self.mean) + np.array(self.spread) * (
            root @ np.clip(rng.standard_normal(3), -2.2, 2.2)
        )
        return float(length), float(w), float(h)

    def body(self, size: Size, rng: np.random.Generator) -> Size:
        """The body within a box of this size."""
        if self.inset is None:
            return size[0], size[1], size[2] + self.lift
        margin = np.clip(rng.normal(*self.inset), -0.05, 0.25)
        return float(size[0] - margin[0]), float(size[1] - margin[1]), float(size[2] - margin[2])


# The outermost points on KITTI's cars lie 2 cm behind the box's sides, 4 behind its ends and 6 below its top.
INSET = ((0.03, 0.06, 0.01), (0.06, 0.04, 0.02))
KINDS = {
    "Car": Kind((1.53, 1.62, 3.89), (0.138, 0.106, 0.44), (0.24, 0.19, 0.36), vehicles.car, INSET),
    "Van": Kind((2.19, 1.91, 5.1), (0.318, 0.17, 0.75), (0.7, 0.8, 0.7), vehicles.van, INSET),
    "Truck": Kind((3.36, 2.61, 9.2), (0.3, 0.2, 1.9), (0.54, 0.6, 0.6), vehicles.truck, INSET),
    "Tram": Kind((3.53, 2.36, 15.5), (0.13, 0.12, 3.0), (-0.5, -0.5, 0.14), vehicles.tram),
    "Misc": Kind((1.9, 1.7, 3.2), (0.35, 0.3, 0.8), (0.2, 0.2, 0.6), vehicles.trailer, INSET),
    "Pedestrian": Kind(
        (1.77, 0.63, 0.82), (0.12, 0.12, 0.22), (0.19, 0.33, 0.08), people.pedestrian
    ),
    "Person_sitting": Kind((1.28, 0.54, 1.06), (0.08, 0.07, 0.2), (0.0, 0.3, -0.3), people.sitting),
    "Cyclist": Kind((1.72, 0.57, 1.77), (0.1, 0.12, 0.15), (0.12, 0.25, 0.47), people.cyclist),
}


@dataclass(frozen=True)
class Thing:
    """A road user that KITTI would label.

    Args:
        kind: of ``KINDS``.
        position: bottom centre, LiDAR frame.
        size: length, width, height.
        yaw: heading.
    """

    kind: str
    position: tuple[float, float, float]
    size: Size
    yaw: float


class Site:
    """A road and its surroundings, seen from the LiDAR at the origin.

    Args:
        rng: of every choice.
        ground: below it.
        heading: of the road at the LiDAR, radians.
        bend: of the road, 1/metres.
        half_view: degrees to either side of the x axis that will be looked at; things elsewhere are left out.
        kinds: what may be added, by name.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        ground: Ground,
        heading: float,
        bend: float,
        half_view: float,
        kinds: Mapping[str, Kind] = KINDS,
    ) -> None:
        self.kinds = kinds
        self.rng, self.ground, self.heading, self.bend = rng, ground, heading, bend
        self.things: list[Thing] = []
        self._parts: list[Parts] = []
        self._placements: list[tuple[float, ...]] = []
        self._owners: list[int] = []
        self._feet = np.zeros((_ROOM, 5))
        self._feet[0] = 0.0, 0.0, 6.0, 2.4, heading  # the recording car itself
        self._n_feet = 1
        self._half_view = np.deg2rad(half_view)
        self._hidden = (
            -1.0
        )  # angle to either side of the x axis within which nothing is placed any more
        self._raised: dict[int, tuple[float, float, float]] = {}

    def look_around(self, rng: np.random.Generator) -> None:
        """From now on fill what lies outside the view, all around, with another generator."""
        self.rng, self._hidden, self._half_view = rng, self._half_view, np.pi

    def raise_ground(self, side: int, kerb: float, width: float, height: float) -> None:
        """Let what stands behind a kerb stand ``height`` metres higher; ``side`` is 1 to the left, -1 to the right."""
        self._raised[side] = kerb, width, height

    def _lift(self, across: float) -> float:
        for side, (kerb, width, height) in self._raised.items():
            if 0 < side * (across - kerb) < width:
                return height
        return 0.0

    def locate(self, along: float, across: float) -> tuple[float, float, float]:
        """x, y and the road's heading at a place."""
        turn = self.heading + self.bend * along
        if abs(self.bend) < 1e-6:
            x, y = along * np.cos(self.heading), along * np.sin(self.heading)
        else:
            x = (np.sin(turn) - np.sin(self.heading)) / self.bend
            y = (np.cos(self.heading) - np.cos(turn)) / self.bend
        return float(x - across * np.sin(turn)), float(y + across * np.cos(turn)), float(turn)

    def seen(self, x: float, y: float, reach: float) -> bool:
        """Whether something of this reach may be in view."""
        distance = np.hypot(x, y)
        if distance > FAR + reach:
            return False
        near, aside = distance < reach + 1, abs(np.arctan2(y, x))
        if self._hidden >= 0 and (near or aside < self._hidden + reach / distance):
            return False
        return bool(near or aside < self._half_view + reach / distance)

    def add(self, kind: str, along: float, across: float, turn: float, gap: float = 0.25) -> bool:
        """Put a road user down, unless it would stand in something."""
        x, y, road = self.locate(along, across)
        wanted = self.kinds[kind]
        size = wanted.draw(self.rng)
        if not self.seen(x, y, size[0] / 2) or not self._claim(
            x, y, road + turn, size[0] + gap, size[1] + gap
        ):
            return False
        z = self._put(
            wanted.make(wanted.body(size, self.rng), self.rng),
            x,
            y,
            road + turn,
            len(self.things),
            self._lift(across),
        )
        loose = self.rng.normal(0, 0.02, 3)  # annotators' hands
        at = (x + loose[0], y + loose[1], z + wanted.lift + loose[2])
        self.things.append(Thing(kind, at, size, float(road + turn)))
        return True

    def put(
        self,
        parts: Parts,
        along: float,
        across: float,
        turn: float = 0.0,
        room: tuple[float, float] | None = None,
        at: float = 0.0,
    ) -> bool:
        """Put something else down; with ``room`` (length, width) only where that is free, ``at`` metres to its left."""
        x, y, road = self.locate(along, across)
        yaw = road + turn
        if room is not None:
            cx, cy = x - at * np.sin(yaw), y + at * np.cos(yaw)
            if not self.seen(cx, cy, max(room) / 2) or not self._claim(cx, cy, yaw, *room):
                return False
        if room is None and not self.seen(x, y, 60.0):
            return False
        self._put(parts, x, y, yaw, -1, 0.0 if room is None else self._lift(across))
        return True

    def free(
        self, along: float, across: float, turn: float, length: float, width: float, at: float = 0.0
    ) -> bool:
        """Whether there is room, in view."""
        x, y, road = self.locate(along, across)
        yaw = road + turn
        x, y = x - at * float(np.sin(yaw)), y + at * float(np.cos(yaw))
        foot = np.array([x, y, length, width, yaw])
        return self.seen(x, y, max(length, width) / 2) and not _collides(
            self._feet, self._n_feet, foot
        )

    def _claim(self, x: float, y: float, yaw: float, length: float, width: float) -> bool:
        foot = np.array([x, y, length, width, yaw])
        if self._n_feet == _ROOM or _collides(self._feet, self._n_feet, foot):
            return False
        self._feet[self._n_feet] = foot
        self._n_feet += 1
        return True

    def _put(self, parts: Parts, x: float, y: float, yaw: float, owner: int, lift: float) -> float:
        z, slope_x, slope_y = (self.ground.even if lift else self.ground).at(x, y)
        z += lift  # a pavement is even
        self._parts.append(parts)
        self._placements += [(x, y, z, yaw, slope_x, slope_y)] * len(parts)
        self._owners += [owner] * len(parts)
        return z

    def solids(self) -> Solids:
        """Everything, ready for rays."""
        return Solids(
            np.concatenate(self._parts),
            np.array(self._placements),
            np.array(self._owners, dtype=np.int64),
        )


@numba.njit(cache=True)
def _collides(feet: Float, n: int, foot: Float) -> bool:
    """Whether a rectangle (x, y, length, width, yaw) overlaps one of the first n: separating axes."""
    for k in range(n):
        dx, dy = feet[k, 0] - foot[0], feet[k, 1] - foot[1]
        reach = (np.hypot(feet[k, 2], feet[k, 3]) + np.hypot(foot[2], foot[3])) / 2
        if dx * dx + dy * dy >= reach * reach:
            continue
        apart = False
        for yaw in (feet[k, 4], foot[4]):
            for side in range(2):
                ax, ay = (np.cos(yaw), np.sin(yaw)) if side == 0 else (-np.sin(yaw), np.cos(yaw))
                if abs(dx * ax + dy * ay) >= _extent(feet[k], ax, ay) + _extent(foot, ax, ay):
                    apart = True
        if not apart:
            return True
    return False


@numba.njit(cache=True, inline="always")
def _extent(foot: NDArray[np.float64], ax: float, ay: float) -> float:
    cos, sin = np.cos(foot[4]), np.sin(foot[4])
    return 0.5 * (foot[2] * abs(cos * ax + sin * ay) + foot[3] * abs(cos * ay - sin * ax))
