"""The checkpoints of a sweep held against the labels, and their APs in resamples of the frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fl3d.analysis import AVERAGES
from fl3d.data.classes import CARS
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.bootstrap import resampled_aps, unit_weights, widened
from fl3d.evaluation.intervals import Interval, Sample, lasting_share
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from fl3d.runs.finished import FinishedSweep

CELLS = tuple((metric, difficulty) for metric in METRICS for difficulty in DIFFICULTIES)
# Group, then level, then seed.
Comparisons = dict[str, dict[str, dict[int, Comparison]]]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Resampled:
    """APs of one checkpoint, by ``CELLS`` and ``AVERAGES``.

    Args:
        values: (9, 2) on the frames as they are; NaN where the protocol has no such metric, or no ground truth counts.
        draws: (R, 9, 2) in each resample.
        detections: digest of what was detected; empty: nothing was, or it is not known.
    """

    values: Float
    draws: Float
    detections: str = ""


class Measured(NamedTuple):
    """A number of one run of training.

    Args:
        value: on the frames as they are.
        draws: (R,) in each resample.
        detections: see ``Resampled``.
    """

    value: float
    draws: Float
    detections: str = ""


Samples = Mapping[str, Mapping[str, Mapping[int, Resampled]]]


def compare_sweep(sweep: FinishedSweep, rule: str = "last") -> Comparisons:
    """Stored detections of a sweep's trials held against the labels, by group, level and seed.

    Args:
        sweep: its run folders must be at hand.
        rule: which checkpoint stands for a trial, see ``evaluation.selection.select``.

    Raises:
        StoreError: only its scores are here.
        DataError: detections or labels cannot be read.
    """
    steps = sweep.steps(rule)
    found: Comparisons = {}
    for group in sweep.groups:
        found[group] = {level: {} for level in sweep.levels}
    for trial in sweep.trials:
        comparison = sweep.comparison(trial, steps[trial.key])
        found[trial.group][trial.level][trial.seed] = comparison
    return {
        group: {level: by_seed for level, by_seed in levels.items() if by_seed}
        for group, levels in found.items()
    }


def resample(
    comparison: Comparison,
    units: NDArray[np.int64] | None,
    n_resamples: int,
    classes: Sequence[str] = CARS,
) -> Resampled:
    """APs of one checkpoint in resamples of the frames, which are the same for all checkpoints.

    Args:
        comparison: its detections held against the labels.
        units: (F,) what each frame is drawn with; None: each frame by itself.
        n_resamples: how many.
        classes: whose mean AP it is.
    """
    has = comparison.protocol.metrics
    none = (np.full(len(AVERAGES), np.nan), np.full((n_resamples, len(AVERAGES)), np.nan))
    found = [
        resample_mean(comparison, cell, units, n_resamples, classes) if cell[0] in has else none
        for cell in CELLS
    ]
    return Resampled(
        np.stack([values for values, _ in found]),
        np.stack([draws for _, draws in found], axis=1),
        comparison.det.digest,
    )


def counted(
    comparison: Comparison, cell: tuple[str, str], classes: Sequence[str]
) -> tuple[str, ...]:
    """Classes that a mean over some is over: those with a ground truth in the cell; the first where none has one."""
    own = [name for name in classes if comparison.matches(name, *cell).n_gt.any()]
    return tuple(own or classes[:1])


def resample_mean(
    comparison: Comparison,
    cell: tuple[str, str],
    units: NDArray[np.int64] | None,
    n_resamples: int,
    classes: Sequence[str],
) -> tuple[Float, Float]:
    """As ``resample_cell``, of the mean AP over those of some classes that have ground truths there."""
    found = [
        resample_cell(comparison, cell, units, n_resamples, name)
        for name in counted(comparison, cell, classes)
    ]
    if len(found) == 1:
        return found[0]
    return np.mean([values for values, _ in found], axis=0), np.mean([d for _, d in found], axis=0)


def resample_cell(
    comparison: Comparison,
    cell: tuple[str, str],
    units: NDArray[np.int64] | None,
    n_resamples: int,
    name: str,
) -> tuple[Float, Float]:
    """APs of one cell: (2,) on the frames as they are, (R, 2) in each resample; of drives as few as they are.

    NaN where no ground truth counts.
    """
    matches = comparison.matches(name, *cell)
    if not matches.n_gt.sum():
        return np.full(len(AVERAGES), np.nan), np.full((n_resamples, len(AVERAGES)), np.nan)
    n_frames = len(matches.n_gt)
    n_units = n_frames if units is None else int(units.max()) + 1
    once = np.ones((1, n_frames), dtype=np.int32)
    draws = resampled_aps(matches, unit_weights(n_units, n_resamples), units)
    if units is not None and n_units < n_frames:
        draws = widened(draws, units)
    return resampled_aps(matches, once)[0], draws


def paired(
    side: Mapping[int, Resampled], base: Mapping[int, Resampled], cell: int, average: int
) -> tuple[Sample, Sample]:
    """AP and gain of one cell, over the seeds that both sides have.

    Args:
        side: of a level, by seed.
        base: of the baseline, likewise.
        cell: place in ``CELLS``.
        average: place in ``AVERAGES``.
    """

    def drawn(by_seed: Mapping[int, Resampled]) -> dict[int, Measured]:
        return {
            seed: Measured(
                float(one.values[cell, average]), one.draws[:, cell, average], one.detections
            )
            for seed, one in by_seed.items()
        }

    return pair_seeds(drawn(side), drawn(base))


def pair_seeds(side: Mapping[int, Measured], base: Mapping[int, Measured]) -> tuple[Sample, Sample]:
    """AP and gain over the seeds that both sides have, under common weights; of copies the first alone counts.

    The gain's ``copies`` are those of either side.
    """
    shared = sorted(set(side) & set(base))
    own, others = (_copies(runs, shared) for runs in (side, base))
    again = {seed for copies in (*own, *others) for seed in copies[1:]}
    seeds = [seed for seed in shared if seed not in again]
    values = np.array([side[seed].value for seed in seeds])
    draws = np.stack([side[seed].draws for seed in seeds])
    base_values = np.array([base[seed].value for seed in seeds])
    base_draws = np.stack([base[seed].draws for seed in seeds])
    gain = _sample(values - base_values, draws - base_draws, [*own, *others])
    return _sample(values, draws, own), gain


def _copies(runs: Mapping[int, Measured], seeds: Sequence[int]) -> list[tuple[int, ...]]:
    """Seeds whose runs have detected the same to the digit, and anything at all: one run under several seeds."""
    alike: dict[str, list[int]] = {}
    for seed in seeds:
        if runs[seed].detections:
            alike.setdefault(runs[seed].detections, []).append(seed)
    return [tuple(own) for own in alike.values() if len(own) > 1]


def _sample(values: Float, draws: Float, copies: Sequence[tuple[int, ...]]) -> Sample:
    """Of the draws of each seed, (S, R)."""
    first = copies[0] if copies else ()
    return Sample(values, draws.mean(axis=0), lasting_share(draws), first)


def interval_columns(name: str, one: Interval) -> dict[str, object]:
    """An interval as columns of a row: ``gain``, ``gain_low``, ``gain_high``."""
    return {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}
