"""Random scenes: a street of some kind, its traffic, its parked rows, its people and what lies beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fl3d.simulator import roadside
from fl3d.simulator.crowds import PEOPLED, Crowd, Layout, Mood, draw_mood, street_of
from fl3d.simulator.hdl64 import CAMERA_VIEW
from fl3d.simulator.site import FAR, KINDS, PIECE, Site
from fl3d.simulator.streets import STREETS, Street, pick
from fl3d.simulator.terrain import Ground, Road
from fl3d.simulator.verge import Verge

TRAM_SHARE = 0.04  # of the lanes of streets that may have a wide median, as city streets have
DEEP = {0: 2.1, 45: 4.9, 90: 5.0}  # metres that a row takes, by its angle to the road in degrees
OWN_LANE_EMPTY = 0.69  # KITTI: 31 % of the frames have a car ahead in our lane


def random_scene(
    rng: np.random.Generator, half_view: float = CAMERA_VIEW, people: float | None = None
) -> Site:
    """A scene; depends on nothing but the arguments.

    Args:
        rng: of every choice.
        half_view: degrees to either side that the LiDAR will look at. What the camera sees is the same in any case.
        people: how many times as often as in KITTI there are people; None: the streets of the published results, where
            they come by the kind of street alone.
    """
    mood = None if people is None else draw_mood(people, rng)
    if mood is None:
        street = STREETS[pick({name: s.share for name, s in STREETS.items()}, rng)]
    else:
        street = street_of(mood, rng)
    # The road plane under the cars of KITTI's train split, as fitted frame by frame.
    ground = Ground(
        height=rng.normal(-1.72, 0.046),
        slope_x=rng.normal(0.0078, 0.0063),
        slope_y=rng.normal(-0.0091, 0.018),
        bend=rng.normal(3e-5, 1e-4),
    )
    site = Site(
        rng,
        ground,
        rng.normal(0, 0.035),
        rng.normal(0, street.bend),
        min(half_view, CAMERA_VIEW) + 3,
        KINDS if mood is None else PEOPLED,
    )
    around = rng.spawn(1)[0]
    builder = _Builder(site, street, mood)
    builder.fill(2.0)
    if half_view > CAMERA_VIEW:
        site.look_around(around)
        builder.fill(-FAR)
    return site


class _Builder:
    """Fills a site: from the road outwards, so that what comes first has its place."""

    def __init__(self, site: Site, street: Street, mood: Mood | None) -> None:
        self.site, self.street, self.mood = site, street, mood
        self.crossing = site.rng.uniform(14, 55) if site.rng.random() < street.crossing else None
        self.lane = site.rng.uniform(*street.lane)
        self.same, oncoming = int(pick(street.same, site.rng)), int(pick(street.oncoming, site.rng))
        self.own = int(site.rng.integers(self.same))  # lanes to our right
        self.offset = site.rng.normal(0.1, 0.25)
        self.median = site.rng.uniform(*street.median) if oncoming else 0.0
        self.oncoming = oncoming
        right = self.offset - (self.own + 0.5) * self.lane
        self.middle = self.offset + (self.same - self.own - 0.5) * self.lane
        self.edges = {-1: right, 1: self.middle + self.median + oncoming * self.lane}
        self.rows = {side: self._row_angle() for side in (1, -1)}
        self.kerbs = {
            side: self.edges[side]
            + side * ((0.0 if angle is None else DEEP[angle]) + site.rng.uniform(0.1, 0.5))
            for side, angle in self.rows.items()
        }
        site.ground = replace(site.ground, road=self._road())

    def _road(self) -> Road:
        """What the ground needs to know."""
        site, rng = self.site, self.site.rng
        wild = self.street.pavement[1] == 0
        return Road(
            slope=float(np.tan(site.heading)),
            bend=site.bend / 2,
            left=self.kerbs[1],
            right=self.kerbs[-1],
            rise=rng.normal(0.1, 0.1),
            rough=rng.uniform(0.02, 0.12 if wild else 0.05),
            origin_x=rng.uniform(0, 1000),
            origin_y=rng.uniform(0, 1000),
            field=0.0 if self.mood is None else 1.0,
        )

    def fill(self, start: float) -> None:
        """Put everything there, from ``start`` metres along the road on."""
        self.rng, self.start = self.site.rng, start
        self.verge = Verge(self.site, self.street, start, self.crossing)
        self._lanes()
        if self.crossing is not None:
            self._cross(self.crossing)
        if self.mood is None:
            for side in (1, -1):
                pavement = self._edge(side)
                self._people(side, self.kerbs[side])
                self.verge.build(side, self.kerbs[side], pavement)
        else:
            pavements = {side: self._edge(side) for side in (1, -1)}
            layout = Layout(self.edges, self.kerbs, pavements, self.crossing, start)
            Crowd(self.site, self.mood, layout).fill()
            for side in (1, -1):
                self.verge.build(side, self.kerbs[side], pavements[side])
        self.verge.close(self.edges[-1], self.edges[1])

    def _edge(self, side: int) -> float:
        """The parked row of a side and its pavement, whose width is returned."""
        angle = self.rows[side]
        if angle is not None:
            self._park(side, self.edges[side] + side * DEEP[angle] / 2, angle)
        return self.verge.pave(side, self.kerbs[side])

    def _kind(self) -> str:
        return pick(self.street.kinds, self.rng)

    def _lanes(self) -> None:
        """Traffic in every lane."""
        for k in range(self.same):
            self._traffic(self.offset + (k - self.own) * self.lane, 0.0, k == self.own)
        if self.oncoming:
            self._median(self.middle, self.median)
        for k in range(self.oncoming):
            self._traffic(self.middle + self.median + (k + 0.5) * self.lane, np.pi, False)

    def _traffic(self, across: float, turn: float, own: bool) -> None:
        gap = float(self.rng.choice(self.street.gaps))
        tram = 1 < self.street.median[1] < 5 and not own and self.rng.random() < TRAM_SHARE
        along = self.start + self.rng.exponential(gap) + 3
        if own and self.start > 0 and self.rng.random() < OWN_LANE_EMPTY:
            along += self.rng.uniform(30, 80)
        while along < FAR:
            kind = "Tram" if tram else self._kind()
            heading = turn + self.rng.normal(0, 0.03)
            self.site.add(kind, along, across + self.rng.normal(0, 0.25), heading, gap=0.8)
            along += (18.0 if tram else 5.5) + self.rng.exponential(
                gap * (1 + max(0.0, abs(along) - 25) / 25)
            )

    def _median(self, across: float, width: float) -> None:
        if width < 1.5:
            return
        rail = self.rng.random() < 0.6
        for along in np.arange(self.start, FAR, PIECE):
            if rail:
                self.verge.run("rail", along, across + width / 2, 1)
            elif self.rng.random() < 0.4:
                self.verge.run("grass", along, across + width / 2, 1)

    def _cross(self, crossing: float) -> None:
        """A road square to ours, with vehicles on it."""
        turn = np.pi / 2 + self.rng.normal(0, 0.12)
        self.site.put(roadside.crossing_road(90.0, 2 * self.lane + 0.6), crossing, 0.0, turn)
        for side in (1, -1):
            across = side * self.rng.uniform(5, 15)
            while abs(across) < 45:
                lane_at = self.rng.choice([-1, 1])
                heading = turn if lane_at > 0 else turn + np.pi
                self.site.add(self._kind(), crossing + lane_at * self.lane / 2, across, heading)
                across += side * (
                    5.5 + self.rng.exponential(float(self.rng.choice([4.0, 15.0, 40.0])))
                )

    def _row_angle(self) -> int | None:
        """Degrees between a side's parked row and the road; None where nobody parks."""
        if self.site.rng.random() > self.street.parked:
            return None
        return int(pick(self.street.angles, self.site.rng))

    def _park(self, side: int, across: float, degrees: int) -> None:
        """A row of parked vehicles."""
        angle = np.deg2rad(degrees)
        filled = self.rng.uniform(*self.street.filled)
        jitter = 0.3 if degrees == 0 else 0.2
        step = {0: 5.4, 45: 3.3, 90: 2.6}[degrees]
        along = self.start + self.rng.uniform(0, step) + self.rng.exponential(8)
        way = angle * -side + (np.pi if self.rng.random() < (0.85 if side > 0 else 0.1) else 0.0)
        ends = along + self.rng.exponential(30) + 10
        while along < FAR and (along < ends or self.start < 0):
            if along > ends:  # behind us one row follows another
                along += self.rng.uniform(5, 40)
                ends = along + self.rng.exponential(30) + 10
            if self.rng.random() < filled and self.verge.is_open(along, 1.0):
                turn = (
                    way + self.rng.normal(0, 0.035) + (np.pi if self.rng.random() < 0.12 else 0.0)
                )
                self.site.add(
                    self._kind(), along, across + self.rng.normal(0, jitter), turn, gap=0.3
                )
                along += self.rng.exponential(0.5)
            along += step

    def _near(self, shape: float, scale: float) -> float:
        """Somewhere not far along the road: people further off are not seen."""
        behind = self.start < 0 and self.rng.random() < 0.5
        return float(5 + self.rng.gamma(shape, scale)) * (-1 if behind else 1)

    def _people(self, side: int, kerb: float) -> None:
        for _ in range(self.rng.poisson(self.street.people / 2 * self.verge.longer)):
            along, across = self._near(2.0, 9.0), kerb + side * self.rng.uniform(0.2, 3.5)
            if self.rng.random() < 0.15:
                across = self.rng.uniform(0, 1) * kerb  # crossing the road
            turn = self.rng.choice([0.0, np.pi, np.pi / 2, -np.pi / 2]) + self.rng.normal(0, 0.35)
            for k in range(1 + (self.rng.random() < 0.3) + (self.rng.random() < 0.1)):
                kind = "Person_sitting" if self.rng.random() < 0.04 else "Pedestrian"
                self.site.add(kind, along + 0.2 * k, across + 0.75 * k, turn, gap=0.05)
        for _ in range(self.rng.poisson(self.street.cyclists / 2 * self.verge.longer)):
            turn = self.rng.normal(0, 0.25) + (np.pi if side > 0 else 0.0)
            self.site.add(
                "Cyclist",
                self._near(2.2, 8.0),
                kerb - side * self.rng.uniform(-1.5, 0.9),
                turn,
                0.05,
            )
