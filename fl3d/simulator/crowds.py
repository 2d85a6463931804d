"""Who walks, sits and cycles in a street: as often, as many, in such groups and at such places as KITTI's labels say.

All numbers are of the 3712 label files of KITTI's train split, unless another source is named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fl3d.simulator import figures, roadside
from fl3d.simulator.site import KINDS, Kind, Site
from fl3d.simulator.streets import STREETS, ZONE, Street, pick

PEOPLE = {
    "Pedestrian": Kind(
        (1.77, 0.63, 0.82), (0.13, 0.12, 0.25), (0.19, 0.33, 0.08), figures.pedestrian
    ),
    "Person_sitting": Kind(
        (1.28, 0.54, 1.06), (0.08, 0.07, 0.2), (0.0, 0.3, -0.3), figures.sitting
    ),
    "Cyclist": Kind((1.72, 0.57, 1.77), (0.1, 0.14, 0.15), (0.12, 0.25, 0.47), figures.cyclist),
}
# Of one to four, linked where they stand within 1.6 m, in frames with two and more.
GROUPS = (0.54, 0.36, 0.07, 0.03)
FACING = 0.09  # share of groups whose members look at each other
TRIES = 25  # places that are looked at for each
ONE_MORE = 0.2  # share of those that are put down whom nobody labels: something hides them
PICTURE = np.deg2rad(40.0)  # to either side of the camera's axis: who comes into the picture


@dataclass(frozen=True)
class Mood:
    """How lively a street is.

    Args:
        share: of KITTI's frames.
        walkers: how often there are so many, by number from 0 on.
        riding: share of the frames that have riders.
        sitting: share of the frames in which people sit.
        streets: where it may be, with weights.
    """

    share: float
    walkers: tuple[float, ...]
    riding: float
    sitting: float
    streets: Mapping[str, float]


RIDERS = (0.0, 363.0, 91.0, 51.0, 9.0)  # frames that have so many, of those that have any
SITTERS = (0.0, 6.0, 16.0, 3.0, 1.0, 1.0)
MOODS = {
    "a few": Mood(
        0.206,
        (0.0, 572.0, 117.0, 75.0),
        0.186,
        0.01,
        {"residential": 0.42, "city": 0.42, "square": 0.05, "country": 0.05, "zone": 0.06},
    ),
    "crowd": Mood(
        0.051,
        (*(0.0,) * 4, 67.0, 39.0, 19.0, 26.0, 8.0, 12.0, 1.0, 3.0, 10.0, 4.0, 1.0, 0.0, 1.0),
        0.61,
        0.1,
        {"city": 0.25, "square": 0.25, "zone": 0.4, "residential": 0.1},
    ),
    "riders": Mood(
        0.069,
        (1.0,),
        1.0,
        0.0,
        {"residential": 0.35, "city": 0.42, "country": 0.13, "square": 0.05, "car_park": 0.05},
    ),
}
QUIET = Mood(0.0, (1.0,), 0.0, 0.0, {name: street.share for name, street in STREETS.items()})


def draw_mood(rate: float, rng: np.random.Generator) -> Mood:
    """How lively a frame is, people being ``rate`` times as frequent as in KITTI's."""
    draw = rng.random() / rate
    for mood in MOODS.values():
        draw -= mood.share
        if draw < 0:
            return mood
    return QUIET


def street_of(mood: Mood, rng: np.random.Generator) -> Street:
    """A kind of street that has this mood."""
    return {**STREETS, "zone": ZONE}[pick(mood.streets, rng)]


@dataclass(frozen=True)
class Layout:
    """What lies where, by side (1 left, -1 right), metres across the road.

    Args:
        edges: of the outer lanes.
        kerbs: behind the parked rows.
        pavements: widths behind the kerbs.
        crossing: along the road, where another one crosses, or None.
        start: along the road, where the stretch begins that is being filled.
    """

    edges: Mapping[int, float]
    kerbs: Mapping[int, float]
    pavements: Mapping[int, float]
    crossing: float | None
    start: float


Place = tuple[float, float, float]  # along, across, turn


class Crowd:
    """Puts the people of one frame down.

    Args:
        site: to be filled; its kinds are ``PEOPLED``.
        mood: of the frame.
        layout: of the street.
    """

    def __init__(self, site: Site, mood: Mood, layout: Layout) -> None:
        self.site, self.mood, self.layout, self.rng = site, mood, layout, site.rng
        self.open = mood.streets.get("zone", 0.0) > 0.3

    def fill(self) -> None:
        """Put everybody down."""
        if self.rng.random() < self.mood.sitting:
            self._table(self._number(SITTERS))
        left = self._number(self.mood.walkers)
        while left > 0:
            size = min(left, 1 + int(self.rng.choice(len(GROUPS), p=GROUPS)))
            self._group(size)
            left -= size
        if self.rng.random() < self.mood.riding:
            for _ in range(self._number(RIDERS)):
                self._rider()

    def _number(self, weights: tuple[float, ...]) -> int:
        """As many as are labelled, and those whom nobody will label."""
        n = int(self.rng.choice(len(weights), p=np.array(weights) / sum(weights)))
        n *= 1 if self.layout.start > 0 else 2  # behind and beside us there is more room
        return n + int(self.rng.binomial(n, ONE_MORE / (1 - ONE_MORE)))

    def _along(self, nearest: float, shape: float, scale: float) -> float:
        """Near rather than far; where the view is filled already, to either side."""
        along = nearest + float(self.rng.gamma(shape, scale))
        return -along if self.layout.start < 0 and self.rng.random() < 0.6 else along

    def _in_picture(self, along: float, across: float) -> bool:
        """Whether the camera sees a place; of what lies around us, all that it does not see will do."""
        x, y, _ = self.site.locate(along, across)
        return self.layout.start < 0 or abs(np.arctan2(y, x - 0.27)) < PICTURE

    def _side(self, left: float) -> int:
        return 1 if self.rng.random() < left else -1

    def _group(self, size: int) -> None:
        """Side by side, or face to face."""
        facing = size > 1 and self.rng.random() < FACING
        for _ in range(TRIES):
            along, across, turn = self._walk()
            if self._in_picture(along, across) and self.site.add(
                "Pedestrian", along, across, turn, gap=-0.1
            ):
                break
        else:
            return
        for k in range(1, size):
            apart = self.rng.uniform(0.55, 0.85) * (k + 1 >> 1) * (-1) ** k
            ahead = self.rng.normal(0, 0.2)
            if facing:
                apart, ahead = self.rng.normal(0, 0.3), self.rng.uniform(0.75, 1.0)
            u, v = (
                ahead * np.cos(turn) - apart * np.sin(turn),
                ahead * np.sin(turn) + apart * np.cos(turn),
            )
            heading = turn + (np.pi if facing else 0.0) + self.rng.normal(0, 0.12)
            self.site.add("Pedestrian", along + float(u), across + float(v), heading, gap=-0.1)

    def _walk(self) -> Place:
        """Where one of a group walks, and where to."""
        rng, layout = self.rng, self.layout
        side = self._side(0.47)
        kerb, width = layout.kerbs[side], max(layout.pavements[side], 1.5)
        along, draw = self._along(4.5, 1.0, 14.0), rng.random()
        if draw < 0.07 or (self.open and draw < 0.22):  # across the road, or on it
            across = rng.uniform(layout.kerbs[-1], layout.kerbs[1])
            return along, across, self._square() + rng.normal(0, 0.6)
        if draw < 0.24:  # at the kerb, waiting, or between parked cars
            row = min(1.6, abs(kerb - layout.edges[side]))
            return along, kerb + side * rng.uniform(-row, 0.5), self._square() + rng.normal(0, 0.4)
        if draw < 0.36 and layout.crossing is not None:  # at the corner, along the other road
            along = layout.crossing + float(rng.choice([1, -1])) * rng.uniform(3.5, 7.0)
            return along, kerb + side * rng.gamma(1.5, 5.0), self._square() + rng.normal(0, 0.25)
        turn = float(rng.choice([0.0, np.pi]))
        if draw < 0.55:  # off the road: a forecourt, a path, a park
            away = width + rng.gamma(1.5, 4.0)
            return along, kerb + side * away, turn + rng.normal(0, 0.8)
        oblique = 0.15 if rng.random() < 0.5 else 1.1
        return along, kerb + side * rng.uniform(0.3, width + 0.3), turn + rng.normal(0, oblique)

    def _square(self) -> float:
        """A heading across the road."""
        return np.pi / 2 * float(self.rng.choice([1, -1]))

    def _rider(self) -> None:
        for _ in range(TRIES):
            along, across, turn = self._ride()
            if self._in_picture(along, across) and self.site.add(
                "Cyclist", along, across, turn, gap=0.05
            ):
                return

    def _ride(self) -> Place:
        """At the edge of the lanes, on a lane of their own, on a path further off, or across."""
        rng, layout = self.rng, self.layout
        side, draw = self._side(0.34), rng.random()
        edge, kerb, along = layout.edges[side], layout.kerbs[side], self._along(4.0, 2.0, 8.2)
        turn = 0.0 if (side < 0) == (rng.random() < 0.75) else np.pi  # with the traffic, mostly
        if draw < 0.2:
            return along, edge - side * rng.uniform(-0.5, 0.7), turn + rng.normal(0, 0.1)
        if draw < 0.42:
            return along, kerb + side * rng.uniform(0.0, 2.5), turn + rng.normal(0, 0.2)
        if draw < 0.76:
            return along, kerb + side * rng.gamma(6.0, 1.0), turn + rng.normal(0, 0.45)
        if layout.crossing is not None:
            along = layout.crossing + rng.normal(0, 2.5)
        across = rng.uniform(layout.kerbs[-1] - 5.0, layout.kerbs[1] + 5.0)
        return along, across, self._square() + rng.normal(0, 0.4)

    def _table(self, size: int) -> None:
        """People on chairs around a table, or on a bench by the wall."""
        rng = self.rng
        for _ in range(TRIES):
            side = self._side(0.3)
            along = self._along(8.0, 3.0, 3.5)
            across = self.layout.kerbs[side] + side * rng.uniform(2.0, 7.0)
            if self.site.free(along, across, 0.0, 2.6, 2.6) and self._in_picture(along, across):
                break
        else:
            return
        self.site.put(roadside.table(rng), along, across, 0.0, (0.3, 0.3))
        first = 0.0 if rng.random() < 0.1 else np.pi / 2
        for k in range(size):
            angle = first + np.pi * k + (np.pi / 2 if k > 1 else 0.0)
            u, v = 0.74 * np.cos(angle), 0.74 * np.sin(angle)
            turn = angle + np.pi + rng.normal(0, 0.1)
            self.site.add("Person_sitting", along + float(u), across + float(v), turn, gap=-0.15)


# Boxes begin 3 cm above the ground, as on the 32 clouds: 3 cm (cyclists) to 5 (cars within 15 m) in the median.
PEOPLED = {name: replace(kind, lift=0.03) for name, kind in {**KINDS, **PEOPLE}.items()}
