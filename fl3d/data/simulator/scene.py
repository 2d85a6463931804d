"""Random streets: lanes, parked rows, crossings, people, and the clutter that looks like cars."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fl3d.data.simulator.objects import LABELLED, Thing, background, labelled
from fl3d.data.simulator.sensor import Ground
from fl3d.geometry.iou import bev_iou

SENSOR_HEIGHT = 1.73  # metres over the road
FAR = 78.0  # metres: how far the street goes


@dataclass
class Scene:
    """What stands on the ground.

    Args:
        ground: the surface.
        things: labelled objects.
        clutter: everything else.
    """

    ground: Ground
    things: list[Thing] = field(default_factory=list)
    clutter: list[Thing] = field(default_factory=list)


class _Street:
    """Places things in road coordinates: ``along`` the road ahead, ``across`` to the left."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.angle = rng.normal(0, 0.05)
        slope_x, slope_y = rng.normal(0.006, 0.008), rng.normal(0, 0.008)
        self.scene = Scene(Ground(-SENSOR_HEIGHT + rng.normal(0, 0.03), slope_x, slope_y))
        self.lane = rng.uniform(3.0, 3.8)
        offset = rng.normal(0, 0.25)
        self.left = offset + self.lane * (0.5 + rng.integers(1, 4))
        self.right = offset - self.lane * (0.5 + rng.choice([0, 0, 0, 1]))
        self._footprints = np.array([[0.0, 0.0, 7.0, 2.6, 0.0]])  # the recording car itself

    def place(self, kind: str, along: float, across: float, heading: float) -> bool:
        """Put a thing down unless it would stand in another one."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        x, y = along * cos - across * sin, along * sin + across * cos
        position = (x, y, self.scene.ground.at(x, y))
        make = labelled if kind in LABELLED else background
        thing = make(kind, position, heading + self.angle, self.rng)
        footprint = np.array([[x, y, thing.size[0] + 0.3, thing.size[1] + 0.3, thing.yaw]])
        if bev_iou(footprint, self._footprints).max() > 0:
            return False
        self._footprints = np.concatenate([self._footprints, footprint])
        (self.scene.things if kind in LABELLED else self.scene.clutter).append(thing)
        return True

    def vehicle(self) -> str:
        """Which vehicle comes next, at KITTI's rates."""
        return str(self.rng.choice(["Car", "Van", "Truck"], p=[0.87, 0.09, 0.04]))

    def traffic(self) -> None:
        """Moving vehicles in every lane, oncoming on the left."""
        n_lanes = max(1, round((self.left - self.right) / self.lane))
        for k in range(n_lanes):
            across = self.right + (k + 0.5) * self.lane
            oncoming = across > self.lane / 2
            along = self.rng.uniform(4, 25)
            density = self.rng.choice([10.0, 30.0, 90.0])
            while along < FAR:
                heading = self.rng.normal(np.pi if oncoming else 0, 0.03)
                self.place(self.vehicle(), along, across + self.rng.normal(0, 0.25), heading)
                along += 5.5 + self.rng.exponential(density)

    def parked(self) -> None:
        """Rows at either side: along the road, sometimes slanted or square to it."""
        for side, edge in ((1, self.left), (-1, self.right)):
            if self.rng.random() < 0.45:
                continue
            slant = self.rng.choice([0.0, 0.0, 0.0, 0.0, np.pi / 3, np.pi / 2])
            across = edge + side * (1.2 if slant == 0 else 2.6)
            along, filled = self.rng.uniform(1, 9), self.rng.uniform(0.15, 0.8)
            step = 5.6 if slant == 0 else 2.9
            while along < FAR:
                if self.rng.random() < filled:
                    heading = slant * side + self.rng.normal(0, 0.04) + np.pi * self.rng.integers(2)
                    self.place(self.vehicle(), along, across + self.rng.normal(0, 0.15), heading)
                along += step + self.rng.uniform(0, 1.2)
            if side > 0:
                self.left += 2.4 if slant == 0 else 5.2
            else:
                self.right -= 2.4 if slant == 0 else 5.2

    def crossing(self) -> None:
        """Now and then a road that crosses, with vehicles square to ours."""
        if self.rng.random() > 0.2:
            return
        along = self.rng.uniform(12, 45)
        for across in self.rng.uniform(-25, 25, self.rng.integers(1, 4)):
            heading = np.pi / 2 * self.rng.choice([-1, 1]) + self.rng.normal(0, 0.08)
            self.place(self.vehicle(), along + self.rng.choice([-1.8, 1.8]), across, heading)

    def people(self) -> None:
        """Pedestrians on the pavements and crossing; cyclists at the edge of the road."""
        for _ in range(self.rng.poisson(1.5)):
            edge = (
                self.left + self.rng.uniform(0.3, 2)
                if self.rng.random() < 0.5
                else self.right - self.rng.uniform(0.3, 2)
            )
            self.place("Pedestrian", self.rng.uniform(5, 45), edge, self.rng.uniform(-np.pi, np.pi))
        for _ in range(self.rng.poisson(0.4)):
            edge = self.right + 0.6 if self.rng.random() < 0.6 else self.left - 0.6
            self.place("Cyclist", self.rng.uniform(6, 45), edge, self.rng.normal(0, 0.1))

    def roadside(self) -> None:
        """Buildings, hedges, trees and street furniture beyond the pavements."""
        kinds = ["wall", "building", "fence", "hedge", "nothing"]
        for side, edge in ((1, self.left), (-1, self.right)):
            along = self.rng.uniform(-5, 5)
            setback = self.rng.uniform(2.5, 9)
            while along < FAR:
                kind = str(self.rng.choice(kinds, p=[0.15, 0.4, 0.12, 0.18, 0.15]))
                length = self.rng.uniform(5, 18)
                if kind != "nothing":
                    for part in np.arange(along, along + length, 5.0):
                        depth = self.rng.uniform(-0.3, 0.3) + (3.0 if kind == "building" else 0.0)
                        self.place(kind, part + 2.5, edge + side * (setback + depth), 0.0)
                along += length + self.rng.exponential(3)
                setback = float(np.clip(setback + self.rng.normal(0, 1.5), 1.5, 12))
            self._verge(side, edge)

    def _verge(self, side: int, edge: float) -> None:
        for kind, rate in (("tree", 4.0), ("bush", 4.0), ("pole", 3.0), ("cabinet", 1.5), ("sign", 1.5), ("heap", 1.5)):
            for _ in range(self.rng.poisson(rate)):
                across = edge + side * self.rng.uniform(0.6, 10)
                self.place(kind, self.rng.uniform(2, 70), across, self.rng.uniform(-np.pi, np.pi))


def random_scene(rng: np.random.Generator) -> Scene:
    """A street scene; depends on nothing but the generator."""
    street = _Street(rng)
    street.crossing()
    street.traffic()
    street.parked()
    street.people()
    street.roadside()
    return street.scene
