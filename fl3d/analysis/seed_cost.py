"""What one more seed of a level costs, as the seeds so far tell it."""

from __future__ import annotations

import statistics

from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder
from fl3d.runs.trials import FinishedTrial

WORK = ("training", "detection", "scoring")  # of what a marker times; waiting is a part of training


def seed_minutes(sweep: FinishedSweep) -> dict[tuple[str, str], float]:
    """Minutes of work of one seed of each level, with its baseline; by group and level.

    Stages that both share count once; of several seeds the median is told.

    Args:
        sweep: its run folders must be at hand.
    """
    by_place = {(trial.group, trial.level, trial.seed): trial for trial in sweep.trials}
    found: dict[tuple[str, str], list[float]] = {}
    for (group, level, seed), trial in by_place.items():
        base = by_place.get((group, sweep.baseline, seed))
        folders = _folders(trial) | (_folders(base) if base else {})
        minutes = sum(work_seconds(folder) for folder in folders.values()) / 60
        found.setdefault((group, level), []).append(minutes)
    return {place: statistics.median(minutes) for place, minutes in found.items()}


def _folders(trial: FinishedTrial) -> dict[str, RunFolder]:
    return {folder.key: folder for folder in trial.folders}


def work_seconds(folder: RunFolder) -> float:
    """Seconds of work that a stage's checkpoints took, whoever made them.

    Raises:
        CheckpointError: a marker is torn.
    """
    markers = [read_marker(folder, step) for step in folder.steps()]
    return sum(marker.seconds.get(part, 0.0) for marker in markers for part in WORK)
