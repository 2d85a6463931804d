"""Pedestrians and cyclists as parts."""

from __future__ import annotations

import numpy as np

from fl3d.simulator.materials import CLOTH, METAL, RUBBER, SKIN
from fl3d.simulator.solids import Parts, box, ellipsoid, extrusion

_COATS = (
    (0.1, 0.1, 0.14),
    (0.25, 0.28, 0.4),
    (0.5, 0.15, 0.15),
    (0.75, 0.72, 0.65),
    (0.3, 0.34, 0.25),
)


def _upper_body(height: float, at: float, u: float, rng: np.random.Generator) -> list[Parts]:
    coat, reflectance = _COATS[int(rng.integers(len(_COATS)))], rng.uniform(0.1, 0.6)
    chest = (0.14, 0.22, 0.17 * height)
    return [
        ellipsoid(chest, CLOTH, (u, 0.0, at + 0.14 * height), reflectance, coat),
        ellipsoid((0.1, 0.09, 0.075 * height), SKIN, (u + 0.02, 0.0, at + 0.38 * height)),
    ]


def pedestrian(size: tuple[float, float, float], rng: np.random.Generator) -> Parts:
    """Someone who walks or stands: two legs, arms, body and head; now and then a bag."""
    length, width, height = size
    stride = min(0.35, 0.35 * length) * rng.uniform(0.1, 1)
    trousers = rng.uniform(0.1, 0.5)
    parts = [
        box((0.17, 0.15, 0.5 * height), CLOTH, at=(s * stride, s * 0.1, 0.0), reflectance=trousers)
        for s in (1, -1)
    ]
    parts += _upper_body(height, 0.47 * height, 0.0, rng)
    parts += [
        box(
            (0.1, 0.1, 0.33 * height),
            CLOTH,
            at=(-s * stride * 0.6, s * max(0.24, width / 2 - 0.06), 0.48 * height),
        )
        for s in (1, -1)
    ]
    if rng.random() < 0.3:
        parts.append(box((0.25, 0.3, 0.35), CLOTH, at=(-0.22, 0.0, 0.58 * height), reflectance=0.2))
    return np.stack(parts)


def sitting(size: tuple[float, float, float], rng: np.random.Generator) -> Parts:
    """Someone on a bench or a chair."""
    length, width, height = size
    parts = [
        box((0.6 * length, width * 0.7, 0.16), CLOTH, at=(0.1 * length, 0.0, 0.38 * height)),
        box((0.15, width * 0.6, 0.42 * height), CLOTH, at=(0.35 * length, 0.0, 0.0)),
        *_upper_body(height * 1.25, 0.42 * height, -0.15 * length, rng),
    ]
    return np.stack(parts)


def cyclist(size: tuple[float, float, float], rng: np.random.Generator) -> Parts:
    """A rider on a bicycle."""
    length, _, height = size
    wheel = [(0.33 * np.cos(a), 0.34 + 0.33 * np.sin(a)) for a in np.arange(8) * np.pi / 4]
    axle = length / 2 - 0.34
    parts = [extrusion(wheel, 0.03, RUBBER, at=(u, 0.0, 0.0), opening=0.6) for u in (axle, -axle)]
    parts += [
        extrusion(
            ((-0.35, 0.45), (0.1, 0.3), (0.4, 0.75), (-0.25, 0.85)), 0.04, METAL, opening=0.4
        ),
        box((0.06, 0.5, 0.06), METAL, at=(0.42, 0.0, 0.95)),
        extrusion(((-0.12, 0.45), (0.12, 0.35), (0.1, 0.95), (-0.2, 0.95)), 0.16, CLOTH),
        *_upper_body(height, 0.53 * height, 0.05, rng),
    ]
    return np.stack(parts)
