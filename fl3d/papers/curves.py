"""Curves of a sweep's last models: AP over score cut, and precision over recall."""

from __future__ import annotations

import numpy as np
import pandas as pd

from fl3d.analysis.contributions import CUTS, Contributions
from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.reports.figures.curves import METRIC


def cut_curves(made: Contributions) -> pd.DataFrame:
    """3D AP moderate of the last models by score cut; a row a trial and cut, by group, level and seed."""
    sweep = made.sweep
    place = {level: number for number, level in enumerate(sweep.levels)}
    parts = []
    for trial in sorted(sweep.trials, key=lambda t: (t.group, place[t.level], t.seed)):
        front = {"group": trial.group, "level": trial.level, "seed": trial.seed}
        aps = {"score_threshold": CUTS, METRIC: made.at_cuts(trial)}
        parts.append(pd.DataFrame(front | aps))
    return pd.concat(parts, ignore_index=True)


def precision_curves(made: Contributions) -> pd.DataFrame:
    """Precision over recall of 3D moderate, seeds averaged: ``group``, ``level``, ``recall``, ``precision``."""
    recall = np.arange(N_SAMPLES) / (N_SAMPLES - 1)
    found: dict[tuple[str, str], list[np.ndarray]] = {
        (group, level): [] for group in made.sweep.groups for level in made.sweep.levels
    }
    for trial in made.sweep.trials:
        found[trial.group, trial.level].append(made.precision(trial))
    parts = []
    for (group, level), by_seed in found.items():
        if by_seed:
            precision = np.mean(by_seed, axis=0)
            front = {"group": group, "level": level}
            parts.append(pd.DataFrame(front | {"recall": recall, "precision": precision}))
    return pd.concat(parts, ignore_index=True)
