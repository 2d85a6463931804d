"""Everything along a street that is no road user: what a detector mistakes for cars, and what hides them.

Each function returns parts in the thing's own frame: u along the street, v away from it, bottom at the ground.
"""

from __future__ import annotations

import numpy as np

from fl3d.simulator.materials import (
    ASPHALT,
    BARK,
    BRICK,
    GLASS,
    GRASS,
    LEAVES,
    METAL,
    PLASTER,
    RUBBER,
    SIGN,
    SOIL,
    STONE,
    THICKET,
    TRIM,
    WOOD,
    Material,
)
from fl3d.simulator.solids import Parts, box, ellipsoid, extrusion

Rng = np.random.Generator


def building(length: float, height: float, rng: Rng) -> Parts:
    """A façade with bays, windows, doors, a plinth and perhaps a pitched roof; its front is at v = 0."""
    wall: Material = PLASTER if rng.random() < 0.6 else BRICK
    tint = tuple(float(c * rng.uniform(0.75, 1.2)) for c in wall.color)
    reflectance = wall.reflectance * rng.uniform(0.6, 1.3)
    color = (min(tint[0], 1.0), min(tint[1], 1.0), min(tint[2], 1.0))
    deep = 8.0
    parts = [
        box(
            (length, deep, height),
            wall,
            at=(0.0, deep / 2, 0.0),
            reflectance=reflectance,
            color=color,
        )
    ]
    parts.append(box((length, 0.3, rng.uniform(0.3, 1.0)), STONE, at=(0.0, -0.05, 0.0)))
    for u in np.arange(-length / 2 + 1.2, length / 2 - 0.8, rng.uniform(2.2, 3.4)):
        draw = rng.random()
        if draw < 0.55:
            parts.append(
                box(
                    (rng.uniform(0.9, 1.6), 0.2, 1.4),
                    GLASS,
                    at=(u, -0.08, rng.uniform(0.9, 1.3)),
                    opening=0.3,
                )
            )
        elif draw < 0.75:  # a bay or a porch
            size = (
                rng.uniform(1.0, 2.6),
                rng.uniform(0.4, 1.6),
                rng.uniform(0.6, min(height, 5.0)),
            )
            parts.append(
                box(size, wall, at=(u, -size[1] / 2, 0.0), reflectance=reflectance, color=color)
            )
        elif draw < 0.85:  # a balcony or an awning
            parts.append(box((2.0, 1.2, 0.15), STONE, at=(u, -0.6, rng.uniform(2.3, 3.2))))
        if height > 5:
            parts.append(box((1.1, 0.2, 1.4), GLASS, at=(u, -0.08, 4.0), opening=0.3))
    if rng.random() < 0.5:
        parts.append(
            extrusion(
                (
                    (-length / 2, height),
                    (length / 2, height),
                    (length / 2, height + 2.5),
                    (-length / 2, height + 2.5),
                ),
                (deep / 2 + 0.4, 0.2),
                BRICK,
                at=(0.0, deep / 2, 0.0),
            )
        )
    return np.stack(parts)


def wall(length: float, height: float, rng: Rng) -> Parts:
    """A garden wall with pillars."""
    kind = STONE if rng.random() < 0.6 else BRICK
    parts = [box((length, 0.25, height), kind)]
    if rng.random() < 0.5:
        parts += [
            box((0.45, 0.45, height + 0.2), kind, at=(u, 0.0, 0.0)) for u in (-length / 2, 0.0)
        ]
    return np.stack(parts)


def fence(length: float, height: float, rng: Rng) -> Parts:
    """Palings or wire between posts, on a plinth at times."""
    kind = WOOD if rng.random() < 0.5 else METAL
    parts = [box((length, 0.06, height), kind, opening=float(rng.uniform(0.4, 0.92)))]
    parts += [
        box((0.12, 0.12, height + 0.1), kind, at=(u, 0.0, 0.0))
        for u in (-length / 2, -length / 6, length / 6)
    ]
    if rng.random() < 0.4:
        parts.append(box((length, 0.25, 0.45), STONE))
    return np.stack(parts)


def hedge(length: float, height: float, rng: Rng) -> Parts:
    """A hedge, cut or grown wild."""
    deep = rng.uniform(0.5, 1.4)
    wild = rng.random() < 0.5
    parts = [box((length, deep, height * (0.75 if wild else 1.0)), THICKET)]
    for u in rng.uniform(-length / 2, length / 2, int(length) if wild else 0):
        radii = (
            rng.uniform(0.4, 1.1),
            deep * rng.uniform(0.5, 0.9),
            height * rng.uniform(0.25, 0.5),
        )
        parts.append(ellipsoid(radii, THICKET, (float(u), 0.0, height * 0.7)))
    return np.stack(parts)


def tree(rng: Rng) -> Parts:
    """A broad-leaved tree: a trunk, limbs, and a crown of several lumps, at times down to the ground."""
    thick, clear = rng.uniform(0.1, 0.35), rng.uniform(0.7, 3.0)
    reach = rng.uniform(0.9, 2.6)
    parts = [_trunk(thick, clear + reach)]
    parts.append(
        ellipsoid(
            (reach * 0.8, reach * 0.8, reach * rng.uniform(0.6, 1.1)),
            LEAVES,
            (0.0, 0.0, clear + reach),
        )
    )
    for _ in range(int(rng.integers(3, 7))):  # lumps at the skin of the one in the middle
        turn, up = rng.uniform(-np.pi, np.pi), rng.uniform(-0.35, 0.9)
        r, out = reach * rng.uniform(0.35, 0.75), reach * rng.uniform(0.5, 0.9)
        at = (out * np.cos(turn), out * np.sin(turn), clear + reach * (1 + up))
        parts.append(
            ellipsoid((r, r * rng.uniform(0.7, 1.2), r * rng.uniform(0.6, 1.0)), LEAVES, at)
        )
    return np.stack(parts)


def _trunk(radius: float, height: float) -> Parts:
    outline = ((-radius, 0.0), (radius, 0.0), (radius * 0.7, height), (-radius * 0.7, height))
    return extrusion(outline, (radius, radius * 0.7), BARK)


def conifer(rng: Rng) -> Parts:
    """A fir or a thuja: a cone from near the ground."""
    height, radius = rng.uniform(2.5, 9), rng.uniform(0.5, 2.0)
    parts = [_trunk(0.15, height * 0.5)]
    for share in (0.15, 0.4, 0.65, 0.85):
        r = radius * (1.05 - share)
        parts.append(ellipsoid((r, r, height * 0.18), THICKET, (0.0, 0.0, height * share)))
    return np.stack(parts)


def bush(rng: Rng) -> Parts:
    """One bush, as large as a car at times."""
    height, reach = rng.uniform(0.5, 2.6), rng.uniform(0.4, 1.9)
    parts = []
    for _ in range(int(rng.integers(2, 6))):
        radii = (
            reach * rng.uniform(0.4, 0.8),
            reach * rng.uniform(0.4, 0.8),
            height * rng.uniform(0.3, 0.55),
        )
        at = (
            rng.normal(0, 0.4) * reach,
            rng.normal(0, 0.4) * reach,
            height * rng.uniform(0.3, 0.55),
        )
        parts.append(ellipsoid(radii, THICKET if rng.random() < 0.6 else LEAVES, at))
    return np.stack(parts)


def thicket(length: float, height: float, rng: Rng) -> Parts:
    """The edge of a wood: stems, undergrowth and crowns in a ragged front."""
    parts = []
    for u in np.arange(-length / 2, length / 2, 1.1):
        at = (float(u + rng.normal(0, 0.4)), float(rng.uniform(0.0, 2.5)))
        r = rng.uniform(0.7, 1.7)
        low = rng.uniform(0.25, 0.6) * height
        parts.append(ellipsoid((r, r, height * rng.uniform(0.3, 0.5)), LEAVES, (*at, low)))
        if rng.random() < 0.5:
            parts.append(
                ellipsoid((0.9, 0.7, rng.uniform(0.4, 1.1)), THICKET, (at[0], at[1] - 0.8, 0.3))
            )
        if rng.random() < 0.4:
            stem = box((0.2, 0.2, height * 0.7), BARK, at=(at[0] + 0.3, at[1], 0.0))
            parts.append(stem)
    return np.stack(parts)


def grass(length: float, height: float, rng: Rng) -> Parts:
    """High grass and weeds along the edge."""
    parts = []
    for u in np.arange(-length / 2, length / 2, 1.0):
        at = (float(u), float(rng.normal(0, 0.3)), 0.0)
        parts.append(
            ellipsoid((0.8, rng.uniform(0.3, 0.9), height * rng.uniform(0.4, 1.0)), THICKET, at)
        )
    return np.stack(parts)


def bank(length: float, height: float, rng: Rng) -> Parts:
    """A slope beside the road: 6 m deep, rising away from it."""
    half = length / 2
    slope = extrusion(
        ((0.0, -0.3), (6.0, -0.3), (6.0, height), (0.3, 0.0)),
        half,
        GRASS if rng.random() < 0.8 else SOIL,
    )
    slope[1:5] = 0.0, 0.0, 0.0, np.pi / 2  # its outline climbs along v
    return slope[None]


def guard_rail(length: float, height: float, rng: Rng) -> Parts:
    """A crash barrier on posts."""
    parts = [box((length, 0.08, 0.32), METAL, at=(0.0, 0.0, height - 0.32))]
    parts += [
        box((0.1, 0.12, height), METAL, at=(float(u), 0.08, 0.0))
        for u in np.arange(-length / 2 + 0.5, length / 2, 4.0)
    ]
    return np.stack(parts)


def noise_barrier(length: float, height: float, rng: Rng) -> Parts:
    """A tall wall along a fast road."""
    return np.stack([box((length, 0.3, height), WOOD if rng.random() < 0.5 else STONE)])


def pole(rng: Rng) -> Parts:
    """A lamp post, a bollard or a traffic light."""
    draw = rng.random()
    if draw < 0.25:
        return np.stack([box((0.14, 0.14, rng.uniform(0.7, 1.1)), METAL)])
    thick, height = rng.uniform(0.08, 0.25), rng.uniform(2.8, 8.0)
    parts = [box((thick, thick, height), METAL)]
    if draw < 0.5:
        parts.append(box((0.35, 0.35, 0.95), TRIM, at=(0.0, 0.0, min(height - 1.0, 2.4))))
    return np.stack(parts)


def sign(rng: Rng) -> Parts:
    """A road sign: a plate that shines back, on a post."""
    height = rng.uniform(1.9, 2.7)
    plate = box((0.05, rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.9)), SIGN, at=(-0.05, 0.0, height))
    return np.stack([box((0.07, 0.07, height + 0.6), METAL), plate])


def cabinet(rng: Rng) -> Parts:
    """A switch box, a dustbin, a bench, a shed: about as large as parts of a car."""
    draw = rng.random()
    if draw < 0.35:
        return np.stack(
            [box((rng.uniform(0.5, 1.6), rng.uniform(0.35, 0.6), rng.uniform(0.8, 1.5)), METAL)]
        )
    if draw < 0.6:
        bins = int(rng.integers(1, 4))
        return np.stack(
            [
                box((0.6, 0.7, 1.1), TRIM, at=(0.75 * k, 0.0, 0.0), reflectance=0.2)
                for k in range(bins)
            ]
        )
    if draw < 0.75:
        return np.stack(
            [
                box((1.7, 0.5, 0.1), WOOD, at=(0.0, 0.0, 0.4)),
                box((1.7, 0.1, 0.5), WOOD, at=(0.0, 0.25, 0.5)),
            ]
        )
    if draw < 0.9:
        return np.stack(
            [
                box((1.1, 1.1, 1.2), METAL, reflectance=0.35),
                box((1.15, 1.15, 0.15), TRIM, at=(0, 0, 1.2)),
            ]
        )
    return np.stack([box((rng.uniform(2, 4), rng.uniform(1.8, 3), rng.uniform(2.0, 2.6)), WOOD)])


def bicycles(rng: Rng) -> Parts:
    """A rack with bicycles and perhaps a motorcycle."""
    wheel = [(0.33 * np.cos(a), 0.34 + 0.33 * np.sin(a)) for a in np.arange(8) * np.pi / 4]
    parts = []
    for k in range(int(rng.integers(1, 6))):
        at = 0.5 * k
        turn = np.pi / 2 + rng.normal(0, 0.15)
        parts.append(extrusion(wheel, 0.03, RUBBER, at=(at, 0.5, 0.0), yaw=turn, opening=0.6))
        parts.append(extrusion(wheel, 0.03, RUBBER, at=(at, -0.5, 0.0), yaw=turn, opening=0.6))
        parts.append(box((0.9, 0.06, 0.5), METAL, at=(at, 0.0, 0.45), yaw=turn, opening=0.5))
    return np.stack(parts)


def table(rng: Rng) -> Parts:
    """A small table on one foot, as before a café."""
    top = box((0.7, 0.7, 0.04), WOOD, at=(0.0, 0.0, rng.uniform(0.68, 0.76)))
    return np.stack([top, box((0.08, 0.08, 0.7), METAL), box((0.4, 0.4, 0.04), METAL)])


def heap(rng: Rng) -> Parts:
    """Earth, sand, rubble or cut branches."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        radii = (rng.uniform(0.5, 1.8), rng.uniform(0.5, 1.5), rng.uniform(0.3, 1.1))
        parts.append(
            ellipsoid(
                radii,
                SOIL if rng.random() < 0.6 else THICKET,
                (rng.normal(0, 0.8), rng.normal(0, 0.8), 0.0),
            )
        )
    return np.stack(parts)


def pavement(length: float, width: float, height: float, material: Material = STONE) -> Parts:
    """A raised strip behind a kerb, from v = 0 to v = width."""
    return np.stack([box((length, width, height + 0.3), material, at=(0.0, width / 2, -0.3))])


def crossing_road(length: float, width: float) -> Parts:
    """Asphalt: a slab a centimetre above the land, so that it can be seen in the picture."""
    return np.stack([box((length, width, 0.31), ASPHALT, at=(0.0, 0.0, -0.3))])
