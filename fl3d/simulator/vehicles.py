"""Cars of several bodies, vans, trucks and trams, as parts; sizes follow KITTI's label statistics."""

from __future__ import annotations

from functools import cache

import numpy as np

from fl3d.simulator.materials import CLOTH, GLASS, METAL, PAINT, RUBBER, SIGN, TRIM
from fl3d.simulator.solids import (
    COLUMNS,
    HALF_HIGH,
    HALF_LOW,
    MATERIAL,
    MAX_POINTS,
    OUTLINE,
    RED,
    REFLECTANCE,
    Float,
    Parts,
    U,
    V,
    W,
    box,
    extrusion,
)

Size = tuple[float, float, float]  # length, width, height in metres
WINDOW = 0.28  # share of rays that a window lets in; of the others most are lost

# Outlines in shares of length and height, u from -0.5 (tail) to 0.5 (nose): the body, then the cabin above it.
# All have the same number of corners, so that two of them can be blended into a third.
_BODY = {
    "sedan": (
        (-0.47, 0.18),
        (0.44, 0.17),
        (0.475, 0.32),
        (0.46, 0.45),
        (0.23, 0.67),
        (-0.36, 0.73),
        (-0.49, 0.69),
    ),
    "hatchback": (
        (-0.47, 0.18),
        (0.44, 0.17),
        (0.475, 0.32),
        (0.46, 0.45),
        (0.27, 0.66),
        (-0.4, 0.72),
        (-0.5, 0.63),
    ),
    "estate": (
        (-0.47, 0.18),
        (0.44, 0.17),
        (0.475, 0.32),
        (0.46, 0.45),
        (0.25, 0.66),
        (-0.4, 0.72),
        (-0.5, 0.64),
    ),
    "suv": (
        (-0.46, 0.22),
        (0.44, 0.22),
        (0.48, 0.36),
        (0.47, 0.51),
        (0.25, 0.67),
        (-0.4, 0.71),
        (-0.5, 0.63),
    ),
    "minivan": (
        (-0.47, 0.17),
        (0.43, 0.16),
        (0.475, 0.31),
        (0.46, 0.44),
        (0.34, 0.6),
        (-0.4, 0.66),
        (-0.5, 0.57),
    ),
    "small": (
        (-0.47, 0.18),
        (0.44, 0.17),
        (0.48, 0.32),
        (0.46, 0.46),
        (0.29, 0.64),
        (-0.42, 0.69),
        (-0.5, 0.6),
    ),
}
_CABIN = {
    "sedan": ((-0.4, 0.7), (0.26, 0.66), (0.05, 0.96), (-0.03, 1.0), (-0.16, 1.0), (-0.25, 0.96)),
    "hatchback": (
        (-0.48, 0.69),
        (0.29, 0.65),
        (0.08, 0.96),
        (0.01, 1.0),
        (-0.3, 1.0),
        (-0.4, 0.95),
    ),
    "estate": (
        (-0.485, 0.69),
        (0.27, 0.65),
        (0.09, 0.96),
        (0.01, 1.0),
        (-0.36, 1.0),
        (-0.44, 0.96),
    ),
    "suv": ((-0.485, 0.68), (0.27, 0.66), (0.11, 0.97), (0.04, 1.0), (-0.35, 1.0), (-0.44, 0.97)),
    "minivan": (
        (-0.485, 0.63),
        (0.38, 0.6),
        (0.18, 0.96),
        (0.09, 1.0),
        (-0.38, 1.0),
        (-0.45, 0.97),
    ),
    "small": ((-0.485, 0.67), (0.33, 0.63), (0.13, 0.96), (0.06, 1.0), (-0.32, 1.0), (-0.41, 0.96)),
}
BODIES = tuple(_BODY)
# How often each body is seen; our own estimate, no statistic: the labels tell sizes, not bodies.
SHARES = np.array([0.17, 0.3, 0.22, 0.1, 0.12, 0.09])


@cache
def _template(body: str) -> Parts:
    """A car of length 1, half width 1 and height 1."""
    parts = [
        extrusion([(0.93 * u, w) for u, w in _BODY[body]], (1.0, 0.95), PAINT),
        extrusion(
            _BODY[body], (0.74, 0.8), PAINT
        ),  # two bodies, so that nose and tail are rounded from above
        extrusion(_CABIN[body], (0.94, 0.74 if body != "minivan" else 0.8), GLASS, opening=WINDOW),
        extrusion(((-0.32, 0.3), (0.12, 0.3), (0.1, 0.8), (-0.3, 0.8)), 0.72, CLOTH),  # seats
        extrusion(
            ((-0.24, 0.98), (0.03, 0.98), (0.02, 1.004), (-0.23, 1.004)), 0.7, PAINT
        ),  # the roof is no glass
    ]
    wheel = [
        (0.075 * np.cos(a), 0.2 + 0.205 * np.sin(a)) for a in np.arange(8) * np.pi / 4 + np.pi / 8
    ]
    for u in (0.315, -0.305):
        parts += [extrusion(wheel, 0.12, RUBBER, at=(u, v, 0.0)) for v in (0.87, -0.87)]
    parts += [box((0.05, 0.2, 0.1), TRIM, at=(0.16, v, 0.58)) for v in (1.06, -1.06)]  # mirrors
    parts += [box((0.006, 0.6, 0.075), SIGN, at=(u, 0.0, 0.3)) for u in (0.497, -0.495)]  # plates
    return np.stack(parts)


def _scale(length: float, width: float, height: float) -> Float:
    """What a template's columns are multiplied with."""
    scale = np.ones(COLUMNS)
    scale[U], scale[W] = length, height
    scale[[V, HALF_LOW, HALF_HIGH]] = width / 2
    scale[OUTLINE : OUTLINE + 2 * MAX_POINTS : 2] = length
    scale[OUTLINE + 1 : OUTLINE + 2 * MAX_POINTS : 2] = height
    return scale


# Paints: reflectance at 905 nm and colour. Black and dark blue cars are nearly invisible to the LiDAR at an angle.
_PAINTS = (
    (0.06, (0.07, 0.07, 0.09)),
    (0.1, (0.12, 0.14, 0.25)),
    (0.2, (0.34, 0.35, 0.37)),
    (0.35, (0.62, 0.63, 0.66)),
    (0.5, (0.88, 0.88, 0.9)),
    (0.4, (0.55, 0.1, 0.1)),
    (0.3, (0.2, 0.35, 0.55)),
    (0.35, (0.25, 0.4, 0.3)),
)
_PAINT_SHARES = np.cumsum([0.2, 0.1, 0.2, 0.24, 0.12, 0.07, 0.05, 0.02])


def _painted(parts: Parts, rng: np.random.Generator) -> Parts:
    reflectance, color = _PAINTS[
        min(int(np.searchsorted(_PAINT_SHARES, rng.random())), len(_PAINTS) - 1)
    ]
    paint = parts[:, MATERIAL] == PAINT.number
    parts[paint, REFLECTANCE] = reflectance * rng.uniform(0.7, 1.3)
    parts[paint, RED:] = color
    return parts


def car(size: Size, rng: np.random.Generator) -> Parts:
    """A passenger car: two bodies blended, tall ones towards minivan and off-roader."""
    length, _, height = size
    weights = SHARES.copy()
    weights[[3, 4]] *= 3.0 if height > 1.6 else 0.3  # suv, minivan
    weights[5] *= 4.0 if length < 3.6 else 0.2
    edges = np.cumsum(weights)
    first, second = np.searchsorted(edges, rng.random(2) * edges[-1], side="right")
    share = rng.random()
    parts = _template(BODIES[first]) * share + _template(BODIES[second]) * (1 - share)
    return _painted(parts * _scale(*size), rng)


@cache
def _van_template(kind: int) -> Parts:
    nose = (0.34, 0.41, 0.47)[kind]  # a hood, a short one, none
    parts = [
        extrusion(
            ((-0.49, 0.12), (0.47, 0.12), (0.5, 0.25), (0.49, 0.42), (nose, 0.55), (-0.5, 0.55)),
            (0.98, 1.0),
            PAINT,
        ),
        extrusion(((-0.5, 0.55), (0.1, 0.55), (0.1, 1.0), (-0.49, 1.0)), (1.0, 0.92), PAINT),
        extrusion(
            ((0.1, 0.55), (nose, 0.55), (nose - 0.16, 0.96), (0.1, 1.0)),
            (0.97, 0.88),
            GLASS,
            opening=WINDOW,
        ),
        extrusion(((0.1, 0.3), (0.25, 0.3), (0.24, 0.75), (0.1, 0.75)), 0.75, CLOTH),
    ]
    wheel = [
        (0.065 * np.cos(a), 0.145 + 0.15 * np.sin(a)) for a in np.arange(8) * np.pi / 4 + np.pi / 8
    ]
    for u in (0.33, -0.3):
        parts += [extrusion(wheel, 0.11, RUBBER, at=(u, v, 0.0)) for v in (0.88, -0.88)]
    parts += [box((0.03, 0.2, 0.13), TRIM, at=(0.28, v, 0.55)) for v in (1.08, -1.08)]
    return np.stack(parts)


def van(size: Size, rng: np.random.Generator) -> Parts:
    """A delivery van or minibus."""
    return _painted(_van_template(int(rng.integers(3))) * _scale(*size), rng)


def truck(size: Size, rng: np.random.Generator) -> Parts:
    """A lorry: cab, load and wheels; some carry an open bed."""
    length, width, height = size
    cab, bed = rng.uniform(1.8, 2.4), 0.9 + rng.uniform(0, 0.3)
    half, rear = length / 2, -length / 2
    front = half - cab - 0.4
    full = rng.random() < 0.75
    top = height if full else bed + rng.uniform(0.4, 1.0)
    parts = [
        box((front - rear, width, top - bed), PAINT, at=((front + rear) / 2, 0.0, bed)),
        box((length * 0.9, width * 0.5, 0.35), METAL, at=(0.0, 0.0, bed - 0.35)),
        extrusion(
            (
                (half - cab, 0.45),
                (half, 0.45),
                (half, 1.6),
                (half - 0.15, 0.85 * height),
                (half - cab, 0.88 * height),
            ),
            (width * 0.48, width * 0.46),
            PAINT,
        ),
    ]
    wheel = [(0.5 * np.cos(a), 0.5 + 0.5 * np.sin(a)) for a in np.arange(8) * np.pi / 4 + np.pi / 8]
    for u in (half - 1.2, rear + 1.2, rear + 2.4):
        parts += [
            extrusion(wheel, 0.16, RUBBER, at=(u, v, 0.0))
            for v in (width / 2 - 0.16, 0.16 - width / 2)
        ]
    return _painted(np.stack(parts), rng)


def tram(size: Size, rng: np.random.Generator) -> Parts:
    """One car of a tram: skirts, a band of windows, a roof."""
    length, width, height = size
    half = length / 2
    low, high = 0.32 * height, 0.72 * height
    parts = [
        box((length, width, low - 0.15), PAINT, at=(0.0, 0.0, 0.15)),
        box((length * 0.99, width * 0.99, high - low), GLASS, at=(0.0, 0.0, low), opening=0.5),
        box((length * 0.8, width * 0.55, 0.8), CLOTH, at=(0.0, 0.0, low - 0.1)),
        extrusion(
            ((-half, high), (half, high), (0.94 * half, height), (-0.94 * half, height)),
            width / 2,
            PAINT,
        ),
    ]
    return _painted(np.stack(parts), rng)


def trailer(size: Size, rng: np.random.Generator) -> Parts:
    """A caravan or a trailer, KITTI's Misc."""
    length, width, height = size
    body = extrusion(
        (
            (-0.45 * length, 0.4),
            (0.4 * length, 0.4),
            (0.46 * length, 0.7 * height),
            (0.4 * length, height),
        )
        + ((-0.43 * length, height), (-0.48 * length, 0.7 * height)),
        width / 2,
        PAINT,
    )
    parts = [
        body,
        box((0.5, width * 0.9, 0.5), RUBBER),
        box((0.2 * length, 0.1, 0.1), METAL, at=(0.45 * length, 0, 0.4)),
    ]
    return _painted(np.stack(parts), rng)
