"""What the seeds of a planned sweep could tell, and how many seeds a margin would take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fl3d.config.settings import SweepSettings
from fl3d.evaluation.intervals import member_alpha
from fl3d.evaluation.verdicts import FEWEST, MOST, seeds_for, smallest_gain
from fl3d.sweep.pilot import Pilot
from fl3d.sweep.plan import Plan

HOW = (
    "not known: no level has two seeds that are done here. Run a pilot, the same words with seeds=3, "
    "or give the gain's standard deviation between seeds, in AP: --spread S"
)


@dataclass(frozen=True)
class Question:
    """What is asked of the seeds.

    Args:
        sweep: its primary metric and margin.
        baseline: level that the others are held against.
        looks: see ``sweepers.base.Sweeper``.
        asked: margin in place of the sweep's; None: the sweep's.
    """

    sweep: SweepSettings
    baseline: str
    looks: tuple[int, ...] = ()
    asked: float | None = None

    @property
    def margin(self) -> float:
        """Gain that is to be told, AP."""
        return self.sweep.margin if self.asked is None else self.asked

    def is_of(self, plan: Plan) -> bool:
        """Whether a plan compares anything."""
        return any(trial.level != self.baseline for trial in plan.trials)


@dataclass(frozen=True)
class Prospect:
    """What seeds could tell of a group.

    Args:
        smallest: true gain that is told with a chance of four in five, AP; None: too few seeds for any verdict.
        needed: seeds that tell a gain of the margin likewise; None: they do not, however many.
        floor: the smallest gain that these frames tell, were there endless seeds, AP.
    """

    smallest: float | None
    needed: int | None
    floor: float


def prospect(
    pilot: Pilot, n_levels: int, n_seeds: int, margin: float, looks: tuple[int, ...] = ()
) -> Prospect:
    """Look ahead.

    Args:
        pilot: what is known of the gains.
        n_levels: beside the baseline; their intervals hold all at once.
        n_seeds: of each.
        margin: gain to be told, AP.
        looks: numbers of seeds after which verdicts are asked for, see ``evaluation.intervals``.
    """
    alpha = member_alpha(n_levels, n_seeds, looks)
    smallest = None
    if n_seeds >= FEWEST:
        smallest = smallest_gain(pilot.spread, n_seeds, alpha, pilot.frames_of(n_seeds))
    floor = smallest_gain(0.0, n_seeds, alpha, pilot.frames_of(math.inf))
    frames = (pilot.frames, pilot.lasting, pilot.n_seeds)
    return Prospect(smallest, seeds_for(margin, pilot.spread, alpha, *frames), floor)


def power_lines(
    plan: Plan,
    asked: Question,
    pilots: Mapping[str, Pilot],
    price: Callable[[str, int], str],
) -> list[str]:
    """Lines of a preview.

    Args:
        plan: of the sweep.
        asked: of it.
        pilots: what is known, by group.
        price: says what a group costs until it has so many seeds.
    """
    seeds: dict[str, set[int]] = {}
    levels: dict[str, set[str]] = {}
    for trial in plan.trials:
        seeds.setdefault(trial.group, set()).add(trial.seed)
        levels.setdefault(trial.group, set()).add(trial.level)
    if not pilots:
        return [f"  gains   {HOW}"]
    lines = [f"  gains   of {asked.sweep.primary}, told with a chance of four in five:"]
    for group in seeds:
        pilot = pilots.get(group)
        if pilot is None:
            lines.append(f"    {group}: not known, no level of it has two seeds that are done here")
            continue
        n_levels = len(levels[group] - {asked.baseline})
        n_seeds = max([len(seeds[group]), *asked.looks])
        found = prospect(pilot, max(n_levels, 1), n_seeds, asked.margin, asked.looks)
        told = [_smallest(found, n_seeds), _needed(found, asked.margin, n_seeds)]
        if found.needed is not None and found.needed > n_seeds:
            told[-1] += f": {price(group, found.needed)}"
        lines.append(f"    {group}: {'; '.join(told)}")
        lines.append(f"      ({pilot.source})")
    return lines


def _smallest(found: Prospect, n_seeds: int) -> str:
    """What the planned seeds tell."""
    own = "1 seed" if n_seeds == 1 else f"{n_seeds} seeds"
    if found.smallest is None:
        return f"no verdict by {own}, {FEWEST} are the fewest"
    return f"{found.smallest:.2g} AP or more by {own}"


def _needed(found: Prospect, margin: float, n_seeds: int) -> str:
    """What the margin takes."""
    if found.floor > margin:
        return f"{margin:g} AP by no number of seeds, for that more frames must be validated on"
    if found.needed is None:
        return f"{margin:g} AP takes more than {MOST} seeds"
    if found.needed <= n_seeds:
        return f"{margin:g} AP takes {found.needed}, so they are enough"
    return f"{margin:g} AP takes about {found.needed} seeds"
