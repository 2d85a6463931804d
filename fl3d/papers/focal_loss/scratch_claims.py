"""The paper's sentence that a network trained from scratch with the focal loss is unstable at first (§VI-A). Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fl3d.evaluation.intervals import joint_intervals
from fl3d.papers.claim import (
    SEEDS_ALONE,
    Claim,
    interval_text,
    over_seeds,
    seeds_in,
    too_few,
    word_of,
)
from fl3d.papers.focal_loss.window_figures import Array

WHERE = "§VI-A"
PRINTED = "unstable at first"


@dataclass(frozen=True)
class Course:
    """How one training from scratch went, checkpoint by checkpoint.

    Args:
        aps: 3D AP moderate, (C,).
        losses: mean of the whole loss since the checkpoint before, (C,).
    """

    aps: Array
    losses: Array

    @property
    def fall(self) -> float:
        """How far AP falls from one checkpoint to the next in the first half, on average; a rise is no fall."""
        return float(np.maximum(0, -np.diff(_first_half(self.aps))).mean())

    @property
    def rise(self) -> float:
        """By how many percent the loss rises likewise; a fall is no rise."""
        own = _first_half(self.losses)
        return float(100 * np.maximum(0, own[1:] / own[:-1] - 1).mean())


def _first_half(values: Array) -> Array:
    """Of the checkpoints: what "in the beginning" is taken for."""
    return values[: max(2, (len(values) + 1) // 2)]


def scratch_claim(detector: str, courses: Mapping[float, Mapping[int, Course]]) -> Claim:
    """The largest gamma against gamma = 0, seed by seed: falls of AP and rises of the loss, both at once.

    Args:
        detector: whose.
        courses: of its trainings, by gamma and seed, of two checkpoints at least.
    """
    text = f"{detector} trained from scratch under the focal loss: AP falls and loss rises"
    largest = max(courses, default=0.0)
    seeds = sorted(set(courses.get(0.0, {})) & set(courses[largest])) if largest > 0 else []
    if not seeds:
        return Claim(WHERE, text, PRINTED, "", "", "")
    base, focal = ([courses[gamma][seed] for seed in seeds] for gamma in (0.0, largest))
    falls, rises = (
        [(getattr(one, name), getattr(other, name)) for one, other in zip(base, focal, strict=True)]
        for name in ("fall", "rise")
    )
    told = "fall {:.2f} AP to {:.2f}".format(*np.mean(falls, axis=0))
    told += ", rise {:.1f} % to {:.1f} %".format(*np.mean(rises, axis=0))
    ours = f"{told} (γ = 0 to {largest:g}, a checkpoint of the first half)"
    few = too_few(len(seeds))
    if few:
        return Claim(WHERE, text, PRINTED, "", f"{ours}; {seeds_in(len(seeds))}", f"ours: {few}")
    fall, rise = joint_intervals(
        [over_seeds([after - before for before, after in pairs]) for pairs in (falls, rises)]
    )
    ours += f": {interval_text(fall)} AP, {interval_text(rise, 1)} % {SEEDS_ALONE}; {seeds_in(len(seeds))}"
    verdict = f"ours: falls {word_of(fall)}, rises {word_of(rise)}"
    return Claim(WHERE, text, PRINTED, "", ours, verdict)
