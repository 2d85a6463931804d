"""What stands in a street, as solids. Sizes of the labelled classes follow KITTI's label statistics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fl3d.data.simulator.shapes import Shape, box, ellipsoid, prism

Position = tuple[float, float, float]

# Mean and standard deviation of (h, w, l) in metres over KITTI's 7481 label files.
SIZES = {
    "Car": ((1.53, 1.63, 3.88), (0.137, 0.102, 0.426)),
    "Van": ((2.21, 1.90, 5.08), (0.32, 0.18, 0.60)),
    "Truck": ((3.25, 2.59, 10.1), (0.45, 0.22, 2.0)),
    "Pedestrian": ((1.76, 0.66, 0.84), (0.11, 0.14, 0.23)),
    "Cyclist": ((1.74, 0.60, 1.76), (0.10, 0.12, 0.18)),
}
LABELLED = tuple(SIZES)


@dataclass(frozen=True)
class Thing:
    """An object or a piece of clutter.

    Args:
        kind: a KITTI type for labelled objects.
        position: bottom centre, LiDAR frame.
        size: length, width, height.
        yaw: heading.
        shapes: its solids.
    """

    kind: str
    position: Position
    size: tuple[float, float, float]
    yaw: float
    shapes: tuple[Shape, ...]


def labelled(kind: str, position: Position, yaw: float, rng: np.random.Generator) -> Thing:
    """A thing that KITTI would label."""
    mean, spread = SIZES[kind]
    h, w, length = (float(m + s * np.clip(rng.normal(), -2.2, 2.2)) for m, s in zip(mean, spread, strict=True))
    make = {"Car": _car, "Van": _van, "Truck": _truck, "Pedestrian": _pedestrian, "Cyclist": _cyclist}[kind]
    return Thing(kind, position, (length, w, h), yaw, make(position, yaw, (length, w, h), rng))


def _ahead(position: Position, yaw: float, along: float, up: float = 0.0) -> Position:
    return position[0] + along * np.cos(yaw), position[1] + along * np.sin(yaw), position[2] + up


def _car(p: Position, yaw: float, size: tuple[float, float, float], rng: np.random.Generator) -> tuple[Shape, ...]:
    length, w, h = size
    paint = float(rng.choice([0.06, 0.15, 0.35, 0.6]))
    clearance, belt = 0.16 + 0.06 * rng.random(), h * rng.uniform(0.52, 0.6)
    estate = rng.random() < 0.4  # the tail as steep as a hatchback's or an estate's
    floor = length * (rng.uniform(0.72, 0.8) if estate else rng.uniform(0.58, 0.68))
    roof = floor * (rng.uniform(0.68, 0.8) if estate else rng.uniform(0.48, 0.6))
    rear = -0.5 * length + 0.5 * floor + (0.02 if estate else 0.1) * length
    shift = -0.5 * (floor - roof) * (0.75 if estate else 0.1)
    body = prism(
        _ahead(p, yaw, 0, clearance), yaw, (length * 0.96, w), (length, w), belt - clearance, reflectance=paint
    )
    cabin = prism(
        _ahead(p, yaw, rear, belt), yaw, (floor, w * 0.96), (roof, w * 0.78), h - belt, shift, reflectance=paint * 0.5
    )
    axles = (0.31 * length, -0.31 * length)
    wheels = [box(_ahead(p, yaw, a), yaw, (0.62, w * 0.98, 0.6), reflectance=0.08) for a in axles]
    return (body, cabin, *wheels)


def _van(p: Position, yaw: float, size: tuple[float, float, float], rng: np.random.Generator) -> tuple[Shape, ...]:
    length, w, h = size
    paint = float(rng.choice([0.15, 0.5, 0.6]))
    back = 0.78 * length
    load = prism(
        _ahead(p, yaw, (back - length) / 2, 0.25), yaw, (back, w), (back * 0.94, w * 0.92), h - 0.25, reflectance=paint
    )
    hood = box(_ahead(p, yaw, length / 2 - 0.2 * length, 0.25), yaw, (0.4 * length, w, 0.5 * h - 0.25), paint)
    wheels = [box(_ahead(p, yaw, a * length), yaw, (0.65, w * 0.97, 0.65), 0.08) for a in (0.33, -0.33)]
    return (load, hood, *wheels)


def _truck(p: Position, yaw: float, size: tuple[float, float, float], rng: np.random.Generator) -> tuple[Shape, ...]:
    length, w, h = size
    load = box(_ahead(p, yaw, -0.12 * length, 0.9), yaw, (0.76 * length, w, h - 0.9), 0.5)
    cab = box(_ahead(p, yaw, 0.38 * length, 0.4), yaw, (0.22 * length, w * 0.95, 0.8 * h - 0.4), 0.35)
    wheels = [box(_ahead(p, yaw, a * length), yaw, (1.0, w * 0.95, 0.95), 0.08) for a in (0.38, -0.3)]
    return (load, cab, *wheels)


def _pedestrian(
    p: Position, yaw: float, size: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Shape, ...]:
    length, w, h = size
    legs = box(p, yaw, (0.5 * length, 0.5 * w, 0.48 * h), 0.3)
    torso = ellipsoid((p[0], p[1], p[2] + 0.64 * h), (0.4 * w, 0.4 * w, 0.24 * h), 0.35)
    head = ellipsoid((p[0], p[1], p[2] + 0.93 * h), (0.11, 0.11, 0.07 * h), 0.4)
    return legs, torso, head


def _cyclist(p: Position, yaw: float, size: tuple[float, float, float], rng: np.random.Generator) -> tuple[Shape, ...]:
    length, w, h = size
    frame = box(p, yaw, (length, 0.1, 0.55 * h), 0.3, porosity=0.5)
    torso = ellipsoid((p[0], p[1], p[2] + 0.7 * h), (0.45 * w, 0.45 * w, 0.26 * h), 0.35)
    head = ellipsoid((p[0], p[1], p[2] + 0.94 * h), (0.11, 0.11, 0.06 * h), 0.4)
    return frame, torso, head


def background(kind: str, position: Position, yaw: float, rng: np.random.Generator) -> Thing:
    """A piece of clutter."""
    size, shapes = _BACKGROUND[kind](position, yaw, rng)
    return Thing(kind, position, size, yaw, shapes)


Made = tuple[tuple[float, float, float], tuple[Shape, ...]]


def _wall(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    size = (5.0, 0.3, rng.uniform(0.7, 2.4))
    return size, (box(p, yaw, size, 0.45),)


def _building(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    size = (5.0, 6.0, rng.uniform(4, 14))
    bays = [
        box(
            _ahead(p, yaw, a, rng.choice([0.0, 1.0])),
            yaw,
            (rng.uniform(0.3, 1.4), 6.0 + rng.uniform(0.1, 0.8), 2.2),
            0.4,
        )
        for a in rng.uniform(-2.2, 2.2, rng.integers(0, 4))
    ]
    return size, (box(p, yaw, size, rng.uniform(0.25, 0.6)), *bays)


def _fence(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    size = (5.0, 0.15, rng.uniform(0.8, 1.8))
    return size, (box(p, yaw, size, 0.3, porosity=0.55),)


def _hedge(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    size = (5.0, rng.uniform(0.6, 1.6), rng.uniform(0.8, 2.5))
    lumps = [
        ellipsoid(_ahead(p, yaw, a, size[2] * 0.7), (0.9, size[1] * 0.6, size[2] * 0.45), 0.45, 0.35)
        for a in rng.uniform(-2, 2, 3)
    ]
    return size, (box(p, yaw, (size[0], size[1], size[2] * 0.85), 0.45, porosity=0.15), *lumps)


def _tree(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    trunk, height = rng.uniform(0.15, 0.45), rng.uniform(1.2, 3.5)
    crowns = []
    for _ in range(rng.integers(2, 5)):
        r = rng.uniform(0.8, 2.4)
        center = (p[0] + rng.normal(0, 0.8), p[1] + rng.normal(0, 0.8), p[2] + height + r * rng.uniform(0.3, 1.2))
        crowns.append(ellipsoid(center, (r, r, r * rng.uniform(0.6, 1.0)), 0.45, rng.uniform(0.4, 0.8)))
    return (2 * trunk, 2 * trunk, height), (box(p, yaw, (trunk, trunk, height + 1), 0.3), *crowns)


def _bush(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    rx, ry, rz = rng.uniform(0.4, 1.9), rng.uniform(0.4, 1.2), rng.uniform(0.4, 1.1)
    lumps = [
        ellipsoid(
            (p[0] + rng.normal(0, 0.3), p[1] + rng.normal(0, 0.3), p[2] + 0.7 * rz), (rx * s, ry * s, rz * s), 0.45, 0.3
        )
        for s in rng.uniform(0.5, 1.0, rng.integers(1, 4))
    ]
    return (2 * rx, 2 * ry, 2 * rz), tuple(lumps)


def _pole(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    d = rng.uniform(0.08, 0.3)
    return (d, d, 6.0), (box(p, yaw, (d, d, rng.uniform(2.5, 8)), 0.35),)


def _cabinet(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    size = (rng.uniform(0.6, 2.6), rng.uniform(0.4, 1.4), rng.uniform(0.8, 1.7))
    return size, (box(p, yaw, size, 0.35),)


def _sign(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    plate = box((p[0], p[1], p[2] + 1.8), yaw, (0.08, rng.uniform(0.6, 1.8), rng.uniform(0.6, 1.2)), 0.9)
    return (0.2, 1.0, 3.0), (box(p, yaw, (0.08, 0.08, 2.6), 0.4), plate)


def _heap(p: Position, yaw: float, rng: np.random.Generator) -> Made:
    """Low clutter of a car's size: tables, bicycles in a rack, building material."""
    size = (rng.uniform(1.5, 4.5), rng.uniform(0.8, 2.0), rng.uniform(0.5, 1.4))
    parts = [
        box(
            _ahead(p, yaw, a * size[0] / 2),
            yaw + rng.normal(0, 0.6),
            (rng.uniform(0.3, 1.2), rng.uniform(0.2, 0.9), size[2] * b),
            0.35,
            0.2,
        )
        for a, b in zip(rng.uniform(-0.8, 0.8, 4), rng.uniform(0.4, 1.0, 4), strict=True)
    ]
    return size, tuple(parts)


_BACKGROUND: dict[str, Callable[[Position, float, np.random.Generator], Made]] = {
    "wall": _wall,
    "building": _building,
    "fence": _fence,
    "hedge": _hedge,
    "tree": _tree,
    "bush": _bush,
    "pole": _pole,
    "cabinet": _cabinet,
    "sign": _sign,
    "heap": _heap,
}
