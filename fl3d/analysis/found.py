"""What a sweep has found: a verdict on each level, and all gains around it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.gains import gains
from fl3d.analysis.samples import (
    CELLS,
    Measured,
    Samples,
    pair_seeds,
    resample_mean,
)
from fl3d.analysis.seed_cost import seed_minutes
from fl3d.analysis.verdicts import Pairs, judge, primary_place, verdicts
from fl3d.evaluation.bootstrap import N_RESAMPLES
from fl3d.evaluation.counts import count_labels
from fl3d.evaluation.protocol import of_class
from fl3d.evaluation.scoring import ground_truths
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial
from fl3d.runs.units import Units, units_of

Drawn = Mapping[str, Measured]


@dataclass(frozen=True)
class Judged:
    """What a sweep has found.

    Args:
        samples: APs of checkpoints in resamples of the frames.
        gains: every cell, see ``gains.gains``.
        verdicts: a row for each group and level, see ``verdicts``; with ``seed_minutes``, see ``seed_cost``.
        units: what was resampled.
        margin: of the verdicts, AP.
        left_out: trials that are not done, or whose baseline is not, one sentence a group and level; and classes that
            the primary metric cannot count.
        baseline: level that the others are held against; empty: it is not said.
    """

    samples: Samples
    gains: pd.DataFrame
    verdicts: pd.DataFrame
    units: Units
    margin: float
    left_out: tuple[str, ...]
    baseline: str = ""


def judge_sweep(
    sweep: FinishedSweep,
    rule: str = "last",
    n_resamples: int = N_RESAMPLES,
    contributions: Contributions | None = None,
) -> Judged:
    """Hold a sweep's checkpoints against the labels, and judge its levels.

    Args:
        sweep: its run folders must be at hand.
        rule: which checkpoint stands for a trial, see ``evaluation.selection.select``.
        n_resamples: of the frames.
        contributions: of the sweep's trials, where they are at hand; they say how many resamples.

    Raises:
        ConfigError: no trial of the baseline is done.
        StoreError: only its scores are here.
        DataError: detections or labels cannot be read.
    """
    made = contributions or Contributions(sweep, n_resamples)
    samples = made.samples(rule)
    whole, every = sweep, samples
    if sweep.family is not None:  # its levels are judged together, whichever are shown
        whole, every = sweep.family, Contributions(sweep.family, made.n_resamples).samples(rule)
    asked, primary = sweep.settings.sweep, every
    if asked.class_name is not None and sweep.primary_classes != sweep.classes:
        primary = Contributions(whole.of_class(asked.class_name), made.n_resamples).samples(rule)
    found = verdicts(primary, sweep.baseline, asked, sweep.plan.looks, _planned(sweep))
    found = _shown(found, sweep)
    if sweep.class_name is not None and not found.empty:
        found = found.assign(metric=of_class(asked.primary, sweep.class_name))
    return Judged(
        samples=samples,
        gains=_shown(gains(every, sweep.baseline), sweep),
        verdicts=_with_minutes(found, sweep),
        units=made.units,
        margin=asked.margin,
        left_out=(*left_out(sweep), *_classes_left_out(sweep)),
        baseline=sweep.baseline,
    )


def _planned(sweep: FinishedSweep) -> dict[str, int]:
    """How many levels were planned of each group, beside the baseline."""
    places = {(trial.group, trial.level) for trial in sweep.plan.trials}
    return dict(Counter(group for group, level in places if level != sweep.baseline))


def _shown(found: pd.DataFrame, sweep: FinishedSweep) -> pd.DataFrame:
    """Rows of the groups and levels of a sweep's trials; all where it has no other levels."""
    if sweep.family is None or found.empty:
        return found
    places = {(trial.group, trial.level) for trial in sweep.trials}
    kept = [place in places for place in zip(found["group"], found["level"], strict=True)]
    return found[kept].reset_index(drop=True)


def sweep_verdicts(
    sweep: FinishedSweep, n_resamples: int = N_RESAMPLES, drawn: Drawn | None = None
) -> pd.DataFrame:
    """The verdicts of ``judge_sweep`` alone: a ninth of its work, for the primary metric is all that is resampled.

    Args:
        sweep: its run folders must be at hand.
        n_resamples: of the frames.
        drawn: of trials that were looked at before, by their keys, see ``draw_trial``; None: of none.

    Raises:
        StoreError: only its scores are here.
        DataError: detections or labels cannot be read.
    """
    found: dict[str, dict[str, dict[int, Measured]]] = {}
    units = units_of(sweep).of_frames
    known = drawn or {}
    whole = sweep.family or sweep
    for group in whole.groups:
        found[group] = {level: {} for level in whole.levels}
    for trial in whole.trials:
        own = known.get(trial.key) or draw_trial(sweep, trial, units, n_resamples)
        found[trial.group][trial.level][trial.seed] = own
    pairs = {group: _pair_levels(levels, sweep.baseline) for group, levels in found.items()}
    asked, looks = sweep.settings.sweep, sweep.plan.looks
    judged = judge(pairs, sweep.baseline, asked, looks, _planned(sweep))
    return _with_minutes(_shown(judged, sweep), sweep)


def draw_trial(
    sweep: FinishedSweep,
    trial: FinishedTrial,
    units: NDArray[np.int64],
    n_resamples: int = N_RESAMPLES,
) -> Measured:
    """Primary metric of a trial's last checkpoint.

    Raises:
        StoreError: only its scores are here.
        DataError: detections or labels cannot be read.
    """
    cell, average = primary_place(sweep.settings.sweep)
    compared = sweep.comparison(trial)
    values, draws = resample_mean(compared, CELLS[cell], units, n_resamples, sweep.primary_classes)
    return Measured(float(values[average]), draws[:, average], compared.det.digest)


def _pair_levels(levels: Mapping[str, Mapping[int, Measured]], baseline: str) -> Pairs:
    """Each level of a group that shares a seed with the baseline."""
    base = levels.get(baseline, {})
    own = {level: by_seed for level, by_seed in levels.items() if set(by_seed) & set(base)}
    return {level: pair_seeds(by_seed, base) for level, by_seed in own.items()}


def _with_minutes(found: pd.DataFrame, sweep: FinishedSweep) -> pd.DataFrame:
    if found.empty:
        return found
    minutes = seed_minutes(sweep)
    places = zip(found["group"], found["level"], strict=True)
    return found.assign(seed_minutes=[minutes[place] for place in places])


def left_out(sweep: FinishedSweep) -> list[str]:
    """Replicates that no gain counts: they were planned and are not done, or the baseline of their seed is not.

    Of those that are done and yet not shown it is said what their scores lack.
    """
    planned = {(trial.group, trial.level, trial.seed): trial.key for trial in sweep.plan.trials}
    done = {(trial.group, trial.level, trial.seed) for trial in sweep.trials}
    missing: dict[tuple[str, str, str], list[str]] = {}
    for trial in sweep.plan.trials:
        if not sweep.is_asked(trial):
            continue
        if (trial.group, trial.level, trial.seed) not in done:
            unshown = sweep.unshown.get(trial.key)
            why = f"its {unshown}" if unshown else "not done"
        elif (base := (trial.group, sweep.baseline, trial.seed)) not in done:
            unshown = sweep.unshown.get(planned.get(base, ""))
            why = f"its baseline's {unshown}" if unshown else "its baseline is not done"
        else:
            continue
        missing.setdefault((trial.group, trial.level, why), []).append(str(trial.seed))
    return [
        f"{group} {level}: seed {', '.join(seeds)} left out, {why}"
        for (group, level, why), seeds in missing.items()
    ]


def _classes_left_out(sweep: FinishedSweep) -> list[str]:
    """Classes without a ground truth at the primary metric's difficulty: a mean is over the others.

    None where only the sweep's scores are at hand.
    """
    if not sweep.is_from_store:
        return []
    difficulty = sweep.settings.sweep.metric.split("/")[1]
    gt, beyond, points = ground_truths(sweep.validation, sweep.protocol)
    counts = count_labels(gt, sweep.protocol, sweep.primary_classes, beyond, points)
    no_part = ", and no part in a mean" if len(sweep.primary_classes) > 1 else ""
    return [
        f"{name} has no AP at {difficulty}{no_part}: no ground truth of it counts"
        for name, own in counts.counted.items()
        if not own[difficulty]
    ]
