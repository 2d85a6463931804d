"""What is known of a sweep's gains before they are measured: from trials of it that are done, or given by hand."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import resample_mean
from fl3d.config.places import PUBLISHED
from fl3d.config.settings import Settings
from fl3d.core.errors import ConfigError, DataError, StoreError
from fl3d.evaluation.intervals import ALPHA, frames_alpha, lasting_share
from fl3d.evaluation.verdicts import left_of_frames
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import open_sweep
from fl3d.runs.trials import FinishedTrial
from fl3d.runs.units import Units, units_of

Draws = dict[tuple[str, int], NDArray[np.float64]]

RESAMPLES = 1000  # half widths need no more; marks do, see evaluation.bootstrap
SEEDS = 3  # whose detections are looked at, for a plan must be quick


@dataclass(frozen=True)
class Pilot:
    """What is known of the gains of a group.

    Args:
        spread: standard deviation of a gain between seeds, AP.
        frames: half of a gain's interval over frames, AP; 0: not known.
        source: of both, for a reader.
        lasting: share of the variance over frames that more seeds do not take away, see ``intervals.lasting_share``.
        n_seeds: that ``frames`` is of.
    """

    spread: float
    frames: float
    source: str
    lasting: float = 1.0
    n_seeds: int = 1

    def frames_of(self, n_seeds: float) -> float:
        """Half of the interval over frames of so many seeds; of endlessly many the part that lasts."""
        return self.frames * left_of_frames(self.lasting, self.n_seeds, n_seeds)


def find_pilots(
    settings: Settings, groups: Iterable[str], spread: float | None = None
) -> Mapping[str, Pilot]:
    """What is known of the gains of some groups; those of which nothing is known are left out.

    Args:
        settings: of the sweep.
        groups: of its plan.
        spread: given by hand, for all of them; None: as trials tell it that are done.
    """
    try:
        sweep = open_sweep(settings, published=PUBLISHED)
        baseline = sweep.baseline
    except (StoreError, ConfigError):  # never run here, or without this baseline
        return {} if spread is None else {one: with_frames(by_hand(spread), 0.0) for one in groups}
    found = {}
    for group in groups:
        gains = gains_by_seed(sweep, group, baseline)
        pilot = pilot_of(gains) if spread is None else by_hand(spread)
        if pilot is not None:
            found[group] = with_frames(pilot, *known_of_frames(sweep, group))
    return found


def by_hand(spread: float) -> Pilot:
    """A pilot whose spread a user gives."""
    return Pilot(spread, 0.0, f"spread between seeds {spread:g} AP, as given")


def with_frames(pilot: Pilot, frames: float, lasting: float = 1.0, n_seeds: int = 1) -> Pilot:
    """The same, and what is known of the frames, see ``Pilot``."""
    told = f"interval over frames ±{frames:.2g}" if frames else "frames not counted"
    if frames and lasting < 1:
        endless = frames * left_of_frames(lasting, n_seeds, math.inf)
        told += f" with {n_seeds} seeds, ±{endless:.2g} with endlessly many"
    source = f"{pilot.source}; {told}"
    return replace(pilot, frames=frames, source=source, lasting=lasting, n_seeds=n_seeds)


def gains_by_seed(sweep: FinishedSweep, group: str, baseline: str) -> pd.DataFrame:
    """Gains of a group's levels by the primary metric of last checkpoints: a row a seed, a column a level.

    Empty where the group has no baseline.
    """
    last = sweep.select("last")
    own = last[last["group"] == group]
    aps = own.pivot(index="seed", columns="level", values=f"ap_{sweep.settings.sweep.primary}")
    if baseline not in aps:
        return pd.DataFrame()
    return aps.sub(aps[baseline], axis=0).drop(columns=baseline)


def pilot_of(gains: pd.DataFrame) -> Pilot | None:
    """The levels' spreads as one: the root of their mean square, by degrees of freedom.

    Args:
        gains: see ``gains_by_seed``.

    Returns:
        None where no level has two seeds that differ: equal to the digit are copies, or runs that found nothing.
    """
    free = gains.count() - 1
    free = free[gains.nunique() > 1]
    spreads = gains.std(ddof=1)[free.index]
    if free.empty:
        return None
    spread = float(np.sqrt((free * spreads**2).sum() / free.sum()))
    counts = sorted({int(count) + 1 for count in free})
    seeds = f"{counts[0]} seeds" if len(counts) == 1 else f"{counts[0]} to {counts[-1]} seeds"
    levels = "one level" if len(spreads) == 1 else f"{len(spreads)} levels"
    among = "" if len(spreads) == 1 else f", {spreads.min():.2g} to {spreads.max():.2g}"
    source = f"spread between seeds {spread:.2g} AP, of {levels} with {seeds}{among}"
    return Pilot(spread, 0.0, source)


def known_of_frames(sweep: FinishedSweep, group: str) -> tuple[float, float, int]:
    """Half of the interval over frames of a gain's mean over at most three seeds, what of it lasts, and these seeds.

    Of the primary metric; root mean square of the levels', which hold all at once; from few resamples, for it must be
    quick. 0 where nothing is known of it: detections are not at hand.
    """
    unknown = (0.0, 1.0, 1)
    if not sweep.is_from_store:
        return unknown
    steps = sweep.steps("last")
    seeds = sorted({trial.seed for trial in sweep.trials if trial.group == group})[:SEEDS]
    try:
        units = units_of(sweep)
        draws = {
            (trial.level, trial.seed): _draws(sweep, trial, steps[trial.key], units)
            for trial in sweep.trials
            if trial.group == group and trial.seed in seeds
        }
    except (DataError, StoreError):
        return unknown
    gains = _gains(draws, sweep.baseline)
    return _pooled(gains) if gains else unknown


def _pooled(gains: list[NDArray[np.float64]]) -> tuple[float, float, int]:
    """Of the draws of each level, (S, R): half, lasting share and seeds, see ``known_of_frames``."""
    means = np.stack([own.mean(axis=0) for own in gains], axis=1)
    tail = 50 * frames_alpha(means, ALPHA)
    low, high = np.percentile(means, [tail, 100 - tail], axis=0)
    squares = ((high - low) / 2) ** 2
    half = float(np.sqrt(np.mean(squares)))
    if not half > 0:  # NaN where no ground truth counts
        return 0.0, 1.0, 1
    lasting = float(np.average([lasting_share(own) for own in gains], weights=squares))
    return half, lasting, max(len(own) for own in gains)


def _draws(
    sweep: FinishedSweep, trial: FinishedTrial, step: int, units: Units
) -> NDArray[np.float64]:
    """(R,) the primary metric of a checkpoint in resamples of the frames."""
    asked = sweep.settings.sweep
    metric, difficulty = asked.metric.split("/")
    comparison = sweep.comparison(trial, step)
    cell = (metric, difficulty)
    _, draws = resample_mean(comparison, cell, units.of_frames, RESAMPLES, sweep.primary_classes)
    return draws[:, AVERAGES.index(asked.average)]


def _gains(draws: Draws, baseline: str) -> list[NDArray[np.float64]]:
    """(S, R) of each level: its gain with each seed that it shares with the baseline."""
    by_level: dict[str, list[NDArray[np.float64]]] = {}
    for (level, seed), own in draws.items():
        if level != baseline and (baseline, seed) in draws:
            by_level.setdefault(level, []).append(own - draws[baseline, seed])
    return [np.stack(gains) for gains in by_level.values()]
