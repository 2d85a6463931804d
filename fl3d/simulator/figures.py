"""People with limbs: a pedestrian in stride, someone who sits, a rider on a bicycle. Each fills its box as KITTI's do.

Proportions are those of adults: hips at half the height, knees at 0.28, shoulders at 0.82 (u ahead, w up; metres).
"""

from __future__ import annotations

import numpy as np

from fl3d.simulator.materials import FABRIC, METAL, RUBBER, SKIN, TRIM, WOOD, Material
from fl3d.simulator.solids import Color, Float, Parts, box, ellipsoid, extrusion

Rng = np.random.Generator
Size = tuple[float, float, float]  # length, width, height
Point = tuple[float, float]  # u, w

COATS: tuple[Color, ...] = (
    (0.1, 0.1, 0.14),
    (0.25, 0.28, 0.4),
    (0.5, 0.15, 0.15),
    (0.75, 0.72, 0.65),
    (0.3, 0.34, 0.25),
    (0.2, 0.4, 0.5),
    (0.6, 0.5, 0.3),
)
TROUSERS: tuple[Color, ...] = (
    (0.12, 0.14, 0.22),
    (0.2, 0.2, 0.2),
    (0.4, 0.36, 0.3),
    (0.2, 0.28, 0.42),
)
SHOE = 0.27  # metres
WHEEL = 0.34  # metres, radius
SADDLE = (-0.22, 0.93)
CRANK, CRANK_LENGTH = (0.0, 0.29), 0.17
RACK = 0.25  # share of bicycles with bags at the rear wheel


def limb(
    start: Point,
    end: Point,
    thick: float,
    half_width: float,
    material: Material,
    v: float = 0.0,
    reflectance: float | None = None,
    color: Color | None = None,
) -> Float:
    """A slat between two points of the (u, w) plane, ``thick`` metres across, ``v`` metres to the left."""
    along = np.array(end) - start
    aside = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-6) * thick / 2
    corners = [start - aside, end - aside, end + aside, start + aside]
    outline = [(float(u), float(w)) for u, w in corners]
    return extrusion(outline, half_width, material, (0.0, v, 0.0), 0.0, reflectance, color)


def bend(start: Point, end: Point, first: float, second: float, way: float) -> Point:
    """Where the joint is of two bones from start to end; ``way`` is 1 ahead (knees), -1 behind (elbows)."""
    du, dw = end[0] - start[0], end[1] - start[1]
    reach = min(max(float(np.hypot(du, dw)), 1e-6), first + second)
    along = (first**2 - second**2 + reach**2) / (2 * reach)
    aside = way * np.sqrt(max(first**2 - along**2, 0.0))
    u, w = du / reach, dw / reach
    return float(start[0] + along * u - aside * w), float(start[1] + along * w + aside * u)


class Clothes:
    """What one person wears."""

    def __init__(self, rng: Rng) -> None:
        self.coat = COATS[int(rng.integers(len(COATS)))]
        self.trousers = TROUSERS[int(rng.integers(len(TROUSERS)))]
        self.upper, self.lower = rng.uniform(0.25, 0.7), rng.uniform(0.2, 0.6)

    def leg(self, hip: Point, knee: Point, foot: Point, v: float, scale: float) -> list[Parts]:
        """Thigh, shin and shoe; ``scale`` is the height over that of an adult."""
        ankle = (foot[0] - 0.06 * scale, foot[1] + 0.08 * scale)
        return [
            limb(hip, knee, 0.17 * scale, 0.085 * scale, FABRIC, v, self.lower, self.trousers),
            limb(knee, ankle, 0.12 * scale, 0.065 * scale, FABRIC, v, self.lower, self.trousers),
            box((SHOE * scale, 0.1 * scale, 0.09 * scale), RUBBER, at=(foot[0], v, foot[1])),
        ]

    def arm(
        self, shoulder: Point, elbow: Point, hand: Point, v: Point, scale: float
    ) -> list[Parts]:
        """Upper arm and forearm; ``v`` of the one and of the other."""
        return [
            limb(shoulder, elbow, 0.11 * scale, 0.055 * scale, FABRIC, v[0], self.upper, self.coat),
            limb(elbow, hand, 0.09 * scale, 0.045 * scale, FABRIC, v[1], self.upper, self.coat),
        ]

    def trunk(self, hip: Point, neck: Point, broad: float, scale: float) -> list[Parts]:
        """Body from the hips to the neck, and the head above it."""
        lean = np.array(neck) - hip
        ahead = lean / max(float(np.hypot(*lean)), 1e-6)
        head = (neck[0] + 0.12 * scale * float(ahead[0]), neck[1] + 0.14 * scale)
        waist = (hip[0] + 0.45 * float(lean[0]), hip[1] + 0.45 * float(lean[1]))
        below = (hip[0] - 0.05 * float(lean[0]), hip[1] - 0.09 * scale)
        worn = (self.upper, self.coat)
        return [
            limb(below, waist, 0.24 * scale, 0.16 * scale, FABRIC, 0.0, *worn),
            limb(waist, neck, 0.25 * scale, broad, FABRIC, 0.0, *worn),
            ellipsoid((0.115 * scale, 0.09 * scale, 0.15 * scale), SKIN, (head[0], 0.0, head[1])),
        ]


def pedestrian(size: Size, rng: Rng) -> Parts:
    """Someone who walks or stands: the box's length is the stride's, its width the elbows'."""
    length, width, height = size
    scale = height / 1.75
    clothes = Clothes(rng)
    spread = max(length - SHOE * scale, 0.0) / 2  # of each foot from the middle
    swing = min(spread, 0.4 * scale)
    hip = (0.0, np.sqrt(max(0.51**2 - (swing / height) ** 2, 0.16)) * height)
    neck = (0.03, height - 0.29 * scale)  # the head above it
    arms = float(np.clip(width / 2 - 0.05 * scale, 0.2 * scale, 0.4 * scale))
    lifted = rng.uniform(0.0, 0.1) if swing > 0.15 else 0.0
    parts: list[Parts] = []
    first = int(rng.choice([1, -1]))  # which leg is ahead
    for side in (1, -1):
        ahead = side * first
        foot = (ahead * spread, lifted if ahead < 0 else 0.0)
        ankle = (foot[0] - 0.06 * scale, foot[1] + 0.08 * scale)
        knee = bend(hip, ankle, 0.24 * height, 0.24 * height, 1.0)
        parts += clothes.leg(hip, knee, foot, side * 0.1 * scale, scale)
        shoulder = (neck[0], neck[1] - 0.03 * height)
        parts += _arm(clothes, shoulder, -ahead * swing, (side * arms, length / 2), scale, rng)
    parts += clothes.trunk(hip, neck, min(0.19 * scale, arms), scale)
    if length > 0.5 or rng.random() < 0.5:
        parts += _carried(hip, neck, clothes, scale, rng)
    return np.stack(parts)


def _arm(
    clothes: Clothes, shoulder: Point, swing: float, room: Point, scale: float, rng: Rng
) -> list[Parts]:
    """An arm that swings against the legs, or holds something (a telephone, a strap) before the chest.

    ``room`` is how far to the left it hangs, and how far ahead the box reaches.
    """
    aside, ahead = room
    if rng.random() < 0.2:
        hand = (min(shoulder[0] + 0.28 * scale, ahead), shoulder[1] - 0.18 * scale)
    else:
        hand = (shoulder[0] + 0.8 * swing + 0.04, shoulder[1] - 0.52 * scale)
    elbow = bend(shoulder, hand, 0.29 * scale, 0.26 * scale, -1.0)
    return clothes.arm(shoulder, elbow, hand, (aside, aside), scale)


def _carried(hip: Point, neck: Point, clothes: Clothes, scale: float, rng: Rng) -> list[Parts]:
    """A long coat or skirt, a rucksack, a bag, or nothing."""
    draw = rng.random()
    worn = (FABRIC, (0.0, 0.0, 0.0), 0.0, clothes.upper, clothes.coat)
    if draw < 0.2:
        low, high = hip[1] - 0.4 * scale, hip[1] + 0.1 * scale
        skirt = ((-0.2, low), (0.2, low), (0.13, high), (-0.13, high))
        return [extrusion([(u * scale, w) for u, w in skirt], (0.22 * scale, 0.16 * scale), *worn)]
    if draw < 0.38:
        at = (neck[0] - 0.22 * scale, 0.0, neck[1] - 0.5 * scale)
        return [box((0.2 * scale, 0.3 * scale, 0.46 * scale), FABRIC, at, reflectance=0.2)]
    if draw < 0.55:
        at = (hip[0], float(rng.choice([1, -1])) * 0.27 * scale, hip[1] - 0.3 * scale)
        return [box((0.32 * scale, 0.12 * scale, 0.3 * scale), FABRIC, at, reflectance=0.3)]
    return []


def sitting(size: Size, rng: Rng) -> Parts:
    """Someone on a chair, feet before it."""
    length, width, height = size
    scale, clothes, back = height / 1.3, Clothes(rng), -length / 2
    hip = (back + 0.25, 0.5 * scale)
    neck = (back + 0.2, height - 0.28 * scale)
    reach = min(length - 0.3, 0.75)
    knee = (hip[0] + min(0.42 * scale, reach), 0.5 * scale)
    foot = (back + min(length - SHOE / 2, 0.25 + reach + 0.1), 0.0)
    seat: Material = WOOD if rng.random() < 0.5 else METAL
    at = max(width / 2 - 0.06, 0.2)
    parts = [
        box((0.42, min(0.42, width), 0.06), seat, at=(back + 0.25, 0.0, 0.4 * scale)),
        box((0.05, min(0.42, width), 0.45), seat, at=(back + 0.03, 0.0, 0.42 * scale), opening=0.3),
        *(
            box((0.04, 0.04, 0.4 * scale), seat, at=(back + 0.25 + u, v, 0.0))
            for u in (-0.19, 0.19)
            for v in (-0.18, 0.18)
        ),
    ]
    for side in (1, -1):
        parts += clothes.leg(hip, knee, foot, side * 0.11, 1.0)
        hand = (neck[0] + rng.uniform(0.3, 0.5), neck[1] - rng.uniform(0.25, 0.42))
        elbow = bend((neck[0], neck[1] - 0.04), hand, 0.29, 0.26, -1.0)
        parts += clothes.arm((neck[0], neck[1] - 0.04), elbow, hand, (side * at, side * at), 1.0)
    return np.stack([*parts, *clothes.trunk(hip, neck, min(0.19, at), 1.0)])


def _bicycle(axle: float, grips: Point, broad: float, rng: Rng) -> list[Parts]:
    """Two wheels with spokes, a frame of tubes, fork, handlebar and saddle."""
    angles = np.arange(8) * np.pi / 4
    rim = [(WHEEL * np.cos(a), WHEEL + WHEEL * np.sin(a)) for a in angles]
    front, rear, head = (axle, WHEEL), (-axle, WHEEL), (grips[0] - 0.06, grips[1] - 0.2)
    tubes = (
        (CRANK, SADDLE),
        (CRANK, head),
        (SADDLE, head),
        (CRANK, rear),
        (SADDLE, rear),
        (head, front),
    )
    parts = [extrusion(rim, 0.025, RUBBER, (u, 0.0, 0.0), opening=0.65) for u in (axle, -axle)]
    parts += [limb(a, b, 0.045, 0.022, METAL) for a, b in tubes]
    parts += [
        limb(head, grips, 0.04, 0.02, METAL),
        box((0.08, broad, 0.05), METAL, at=(grips[0], 0.0, grips[1])),
        box((0.26, 0.15, 0.06), TRIM, at=(SADDLE[0], 0.0, SADDLE[1])),
    ]
    if rng.random() < RACK:
        parts.append(box((0.3, 0.34, 0.3), FABRIC, at=(-axle - 0.02, 0.0, 0.42), reflectance=0.25))
    if rng.random() < RACK:
        parts.append(box((0.28, 0.36, 0.24), METAL, at=(axle - 0.08, 0.0, 0.8), opening=0.5))
    return parts


def cyclist(size: Size, rng: Rng) -> Parts:
    """A rider who pedals: how far back leans follows from the height, the knees from where the pedals are."""
    length, width, height = size
    scale, clothes = 1.0, Clothes(rng)
    axle = length / 2 - WHEEL
    broad = float(np.clip(width - 0.04, 0.42, 0.66))
    grips = (min(axle - 0.12, 0.48), rng.uniform(0.95, 1.1))
    hip = (SADDLE[0], SADDLE[1] + 0.07)
    high = height - 0.28  # of the neck, the head above it
    lean = np.sqrt(max(0.56**2 - (high - hip[1]) ** 2, 0.0))
    neck = (hip[0] + float(min(lean, 0.45)), high)
    shoulder = (neck[0], neck[1] - 0.05)
    parts = _bicycle(axle, grips, broad, rng)
    phase = rng.uniform(0, 2 * np.pi)
    for side in (1, -1):
        turn = phase + (0.0 if side > 0 else np.pi)
        pedal = (CRANK[0] + CRANK_LENGTH * np.cos(turn), CRANK[1] + CRANK_LENGTH * np.sin(turn))
        foot = (float(pedal[0]) + 0.05, float(pedal[1]))
        ankle = (foot[0] - 0.06, foot[1] + 0.08)
        parts += clothes.leg(hip, bend(hip, ankle, 0.42, 0.42, 1.0), foot, side * 0.12, scale)
        elbow = bend(shoulder, grips, 0.3, 0.28, -1.0)
        at = (side * 0.21, side * (broad / 2 - 0.05))
        parts += clothes.arm(shoulder, elbow, (grips[0], grips[1] + 0.03), at, scale)
    parts += clothes.trunk(hip, neck, 0.19, scale)
    if rng.random() < 0.2:
        at_back = (neck[0] - 0.28, 0.0, neck[1] - 0.48)
        parts.append(box((0.18, 0.3, 0.44), FABRIC, at_back, reflectance=0.2))
    return np.stack(parts)
