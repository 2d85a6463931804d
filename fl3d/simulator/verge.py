"""What lies beside a street: pavements, furniture, fences, houses, trees, and what closes the view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fl3d.simulator import roadside
from fl3d.simulator.materials import PAVING
from fl3d.simulator.site import FAR, PIECE, Site
from fl3d.simulator.solids import Parts
from fl3d.simulator.streets import Street, pick


class Verge:
    """Both sides of a street.

    Args:
        site: to be filled.
        street: its kind.
        start: metres along the road where it begins.
        crossing: where another road crosses, or None.
    """

    def __init__(self, site: Site, street: Street, start: float, crossing: float | None) -> None:
        self.site, self.street, self.rng = site, street, site.rng
        self.start, self.crossing = start, crossing
        self.longer = (75 - start) / 73  # than the stretch before us, for what comes by number

    def is_open(self, along: float, margin: float = 0.0) -> bool:
        """Whether a place lies off the crossing road."""
        return self.crossing is None or abs(along - self.crossing) > 5.0 + margin

    def pave(self, side: int, kerb: float) -> float:
        """Lay the pavement; returns its width, 0 where there is none. What comes later stands on it."""
        width = float(self.rng.uniform(*self.street.pavement))
        if width == 0:
            return 0.0
        height, broad = self.rng.uniform(0.04, 0.16), width + 3.0
        for along in np.arange(self.start + PIECE / 2, 70.0, PIECE):
            if self.is_open(along, 1.0) and self.site.seen(
                *self.site.locate(along, kerb)[:2], PIECE
            ):
                self.site.put(
                    roadside.pavement(PIECE, broad, height, PAVING),
                    along,
                    kerb,
                    0.0 if side > 0 else np.pi,
                )
        self.site.raise_ground(side, kerb, broad, height)
        return width

    def build(self, side: int, kerb: float, pavement: float) -> None:
        """Furniture, what bounds the land, and what stands on it."""
        self._furniture(side, kerb, pavement)
        setback = self.rng.uniform(*self.street.setback)
        front = kerb + side * (pavement + self.rng.uniform(0.1, 1.2))
        self._line(self.street.front, side, front, 0.3)
        self._line(self.street.back, side, max(abs(front) + 1.0, abs(kerb) + setback) * side, 0.8)
        behind = max(abs(front), abs(kerb) + setback) + self.rng.uniform(5, 14)
        self._line({"thicket": 0.45, "building": 0.45, "none": 0.1}, side, behind * side, 1.5)
        for _ in range(
            self.rng.poisson(5.0 * self.longer)
        ):  # further out, where nothing is planned
            across = kerb + side * self.rng.uniform(10, 40)
            self._scatter(
                pick({"tree": 0.4, "bush": 0.3, "conifer": 0.15, "heap": 0.15}, self.rng), across
            )

    def _furniture(self, side: int, kerb: float, pavement: float) -> None:
        for kind in ("pole", "pole", "sign", "cabinet", "bicycles", "bush"):
            for _ in range(self.rng.poisson(self.street.clutter / 6 * self.longer)):
                self._scatter(kind, kerb + side * self.rng.uniform(0.3, pavement + 1.5))
        if self.rng.random() < 0.4:  # an avenue
            step, across = self.rng.uniform(6, 14), kerb + side * self.rng.uniform(0.6, 1.6)
            for along in np.arange(self.start + self.rng.uniform(0, step), 70, step):
                self._scatter("tree", across, along)
        for _ in range(self.rng.poisson(self.street.trees * self.longer)):
            kind = "tree" if self.rng.random() < 0.7 else "conifer"
            self._scatter(kind, kerb + side * (pavement + self.rng.uniform(0.5, 14)))

    def _scatter(self, kind: str, across: float, along: float | None = None) -> None:
        along = self.rng.uniform(self.start + 1, 75) if along is None else along
        if not self.is_open(along) or not self.site.free(along, across, 0.0, 1.0, 1.0):
            return
        parts, room = self._single(kind)
        self.site.put(
            parts, along, across, self.rng.uniform(-np.pi, np.pi) if kind != "sign" else 0.0, room
        )

    def _single(self, kind: str) -> tuple[Parts, tuple[float, float]]:
        make = {
            "tree": (roadside.tree, (0.8, 0.8)),
            "conifer": (roadside.conifer, (1.6, 1.6)),
            "bush": (roadside.bush, (1.6, 1.6)),
            "pole": (roadside.pole, (0.3, 0.3)),
            "sign": (roadside.sign, (0.3, 0.6)),
            "cabinet": (roadside.cabinet, (1.4, 0.8)),
            "bicycles": (roadside.bicycles, (1.8, 1.8)),
            "heap": (roadside.heap, (2.5, 2.5)),
        }[kind]
        return make[0](self.rng), make[1]

    def _line(self, weights: Mapping[str, float], side: int, across: float, wander: float) -> None:
        """A run of one kind, then of another, along the road."""
        along = self.start - self.rng.uniform(0, 8)
        while along < FAR - 10:
            kind, until = pick(weights, self.rng), along + self.rng.uniform(6, 30)
            height = self._height(kind)
            while along < until:
                length = self.rng.uniform(8, 18) if kind == "building" else PIECE
                if kind != "none" and self.is_open(along + length / 2, length / 2):
                    self.run(
                        kind,
                        along + length / 2,
                        across + self.rng.normal(0, 0.1),
                        side,
                        length,
                        height,
                    )
                along += length + (self.rng.exponential(2.5) if kind == "building" else 0.0)
            across += self.rng.normal(0, wander)

    def _height(self, kind: str) -> float:
        ranges = {
            "building": (3.0, 13.0),
            "wall": (0.6, 2.2),
            "fence": (0.8, 1.9),
            "hedge": (0.8, 2.6),
            "grass": (0.2, 0.8),
            "thicket": (3.0, 8.0),
            "bank": (0.6, 3.5),
            "barrier": (1.2, 4.0),
            "rail": (0.7, 0.9),
        }
        return float(self.rng.uniform(*ranges.get(kind, (1.0, 2.0))))

    def run(
        self,
        kind: str,
        along: float,
        across: float,
        side: int,
        length: float = PIECE,
        height: float = 0.8,
    ) -> None:
        """A piece of fence, hedge, wall, wood, or row of houses, where there is room; ``side`` is 1 to the left."""
        rng, turn = self.rng, 0.0 if side > 0 else np.pi
        deep = {
            "building": 8.0,
            "bank": 6.0,
            "thicket": 3.0,
            "bushes": 2.5,
            "conifers": 2.0,
            "rows": 4.8,
        }.get(kind, 0.5)
        if not self.site.free(along, across, turn, length * 0.9, deep * 0.9, at=deep / 2 + 0.1):
            return
        if kind in ("bushes", "conifers"):
            for u in np.arange(-length / 2, length / 2, rng.uniform(1.2, 3.0)):
                parts = roadside.bush(rng) if kind == "bushes" else roadside.conifer(rng)
                self.site.put(
                    parts,
                    along + u,
                    across + side * rng.uniform(0.3, 2.5),
                    rng.uniform(-3, 3),
                    (1.2, 1.2),
                )
            return
        if kind == "rows":  # another row of a car park
            for u in (-1.3, 1.3):
                self.site.add(
                    pick(self.street.kinds, rng), along + u, across + side * 2.4, np.pi / 2 * side
                )
            return
        make = {
            "building": roadside.building,
            "wall": roadside.wall,
            "fence": roadside.fence,
            "hedge": roadside.hedge,
            "grass": roadside.grass,
            "thicket": roadside.thicket,
            "bank": roadside.bank,
            "barrier": roadside.noise_barrier,
            "rail": roadside.guard_rail,
        }[kind]
        self.site.put(
            make(length, height, rng),
            along,
            across,
            turn,
            (length * 0.98, deep * 0.9),
            at=deep / 2 + 0.1,
        )

    def close(self, right: float, left: float) -> None:
        """What closes the view: streets bend, and KITTI's rays meet something ahead as often as not."""
        rng = self.rng
        if rng.random() < 0.35:
            along, length = rng.uniform(38, 85), rng.uniform(15, 50)
            make = roadside.building if rng.random() < 0.6 else roadside.thicket
            self.site.put(
                make(length, rng.uniform(4, 12), rng),
                along,
                rng.normal(0, 6),
                -np.pi / 2,
                (length, 6.0),
                3.0,
            )
        for _ in range(rng.poisson(7)):
            along, across = rng.uniform(42, 85), rng.uniform(left + 1.5, left + 30)
            if rng.random() < 0.5:
                across = rng.uniform(right - 30, right - 1.5)
            self._scatter(pick({"tree": 0.5, "conifer": 0.2, "bush": 0.3}, rng), across, along)
