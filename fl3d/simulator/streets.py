"""Kinds of streets, as numbers. Lanes, rows and headings follow KITTI's labels (see ``benchmarks/README.md``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

Range = tuple[float, float]
Weights = Mapping[str, float]


def pick(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    """One of the names, at random by weight."""
    draw = rng.random() * sum(weights.values())
    for name, weight in weights.items():
        draw -= weight
        if draw < 0:
            return name
    return name


@dataclass(frozen=True)
class Street:
    """One kind of street.

    Args:
        share: how often it comes.
        lane: width of a lane in metres.
        same: lanes in our direction, with weights; we drive in any of them.
        oncoming: lanes in the other direction, with weights.
        median: metres between the directions.
        gaps: mean metres between vehicles in a lane; one is drawn for each lane.
        parked: probability of a row at either side.
        angles: of a parked row to the road in degrees, with weights.
        filled: share of a row's places that are taken.
        crossing: probability that another road crosses.
        pavement: width in metres; (0, 0) has none and no kerb.
        people: pedestrians, in the mean.
        cyclists: in the mean.
        front: what bounds the road's land (fences, hedges), with weights.
        back: what stands behind it, with weights.
        setback: metres from the kerb to ``back``.
        clutter: pieces of street furniture per side, in the mean.
        trees: likewise.
        bend: standard deviation of the road's bend, 1/metres.
    """

    share: float
    lane: Range
    same: Weights
    oncoming: Weights
    median: Range
    gaps: tuple[float, ...]
    parked: float
    angles: Weights
    filled: Range
    crossing: float
    pavement: Range
    people: float
    cyclists: float
    front: Weights
    back: Weights
    setback: Range
    clutter: float
    trees: float
    bend: float = 0.002
    kinds: Weights = field(
        default_factory=lambda: {"Car": 0.87, "Van": 0.085, "Truck": 0.03, "Misc": 0.015}
    )


STREETS = {
    "residential": Street(
        share=0.4,
        lane=(2.5, 3.1),
        same={"1": 1.0},
        oncoming={"1": 0.75, "0": 0.25},
        median=(0.0, 0.3),
        gaps=(20.0, 60.0, 120.0),
        parked=0.72,
        angles={"0": 0.7, "45": 0.2, "90": 0.1},
        filled=(0.25, 0.9),
        crossing=0.2,
        pavement=(1.0, 2.6),
        people=0.6,
        cyclists=0.25,
        front={"none": 0.25, "fence": 0.2, "hedge": 0.25, "wall": 0.18, "grass": 0.12},
        back={"building": 0.55, "bushes": 0.2, "thicket": 0.08, "conifers": 0.07, "none": 0.1},
        setback=(1.5, 6.5),
        clutter=6.0,
        trees=9.0,
        bend=0.005,
    ),
    "city": Street(
        share=0.22,
        lane=(2.9, 3.4),
        same={"1": 0.6, "2": 0.4},
        oncoming={"1": 0.6, "2": 0.3, "0": 0.1},
        median=(0.0, 2.5),
        gaps=(9.0, 18.0, 40.0, 90.0),
        parked=0.5,
        angles={"0": 0.8, "45": 0.13, "90": 0.07},
        filled=(0.3, 1.0),
        crossing=0.35,
        pavement=(2.0, 4.5),
        people=2.2,
        cyclists=0.7,
        front={"none": 0.7, "fence": 0.1, "hedge": 0.1, "wall": 0.1},
        back={"building": 0.82, "bushes": 0.08, "thicket": 0.05, "none": 0.05},
        setback=(1.5, 5.0),
        clutter=8.0,
        trees=7.0,
        bend=0.003,
    ),
    "country": Street(
        share=0.2,
        lane=(2.9, 3.6),
        same={"1": 1.0},
        oncoming={"1": 1.0},
        median=(0.0, 0.3),
        gaps=(25.0, 60.0, 150.0),
        parked=0.1,
        angles={"0": 0.6, "45": 0.2, "90": 0.2},
        filled=(0.1, 0.5),
        crossing=0.15,
        pavement=(0.0, 0.0),
        people=0.15,
        cyclists=0.15,
        front={"none": 0.35, "grass": 0.35, "rail": 0.12, "hedge": 0.1, "fence": 0.08},
        back={
            "thicket": 0.35,
            "bushes": 0.2,
            "bank": 0.2,
            "building": 0.1,
            "conifers": 0.05,
            "none": 0.1,
        },
        setback=(1.0, 6.0),
        clutter=3.0,
        trees=11.0,
        bend=0.005,
    ),
    "motorway": Street(
        share=0.1,
        lane=(3.4, 3.7),
        same={"2": 0.6, "3": 0.4},
        oncoming={"2": 0.6, "3": 0.3, "0": 0.1},
        median=(2.5, 9.0),
        gaps=(18.0, 35.0, 70.0),
        parked=0.0,
        angles={"0": 1.0},
        filled=(0.0, 0.0),
        crossing=0.0,
        pavement=(0.0, 0.0),
        people=0.0,
        cyclists=0.0,
        front={"rail": 0.6, "barrier": 0.2, "none": 0.2},
        back={"thicket": 0.35, "bank": 0.3, "bushes": 0.2, "none": 0.15},
        setback=(1.5, 6.0),
        clutter=2.0,
        trees=6.0,
        bend=0.0015,
        kinds={"Car": 0.84, "Van": 0.09, "Truck": 0.07},
    ),
    "car_park": Street(
        share=0.04,
        lane=(2.8, 3.4),
        same={"1": 1.0},
        oncoming={"1": 0.5, "0": 0.5},
        median=(0.0, 0.0),
        gaps=(40.0, 120.0),
        parked=0.95,
        angles={"0": 0.1, "45": 0.35, "90": 0.55},
        filled=(0.3, 0.95),
        crossing=0.25,
        pavement=(0.5, 2.0),
        people=0.7,
        cyclists=0.1,
        front={"none": 0.4, "hedge": 0.25, "fence": 0.2, "wall": 0.15},
        back={"building": 0.45, "rows": 0.25, "bushes": 0.15, "none": 0.15},
        setback=(1.5, 6.0),
        clutter=4.0,
        trees=6.0,
        bend=0.003,
    ),
    "square": Street(
        share=0.04,
        lane=(2.5, 3.2),
        same={"1": 1.0},
        oncoming={"0": 0.7, "1": 0.3},
        median=(0.0, 0.0),
        gaps=(80.0, 200.0),
        parked=0.2,
        angles={"0": 1.0},
        filled=(0.1, 0.5),
        crossing=0.1,
        pavement=(2.0, 6.0),
        people=8.0,
        cyclists=1.6,
        front={"none": 0.9, "wall": 0.1},
        back={"building": 0.9, "none": 0.1},
        setback=(3.0, 10.0),
        clutter=9.0,
        trees=6.0,
        bend=0.003,
    ),
}
# Where people walk and few drive: of the streets, only those with many people have it (see ``crowds.py``).
ZONE = Street(
    share=0.0,
    lane=(2.8, 4.0),
    same={"1": 1.0},
    oncoming={"0": 1.0},
    median=(0.0, 0.0),
    gaps=(60.0, 200.0),
    parked=0.08,
    angles={"0": 1.0},
    filled=(0.1, 0.4),
    crossing=0.2,
    pavement=(2.0, 5.0),
    people=0.0,
    cyclists=0.0,
    front={"none": 0.9, "wall": 0.1},
    back={"building": 0.92, "none": 0.08},
    setback=(2.5, 8.0),
    clutter=8.0,
    trees=4.0,
    bend=0.003,
)
