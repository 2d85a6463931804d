"""Honest best: choose on one half of the validation frames, report on the other; from stored detections."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from fl3d.evaluation.bootstrap import resampled_aps
from fl3d.evaluation.detections import Validation, compare_stored
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol
from fl3d.records import Config, StagePaths
from fl3d.reports.figures.curves import best_of_k_figure
from fl3d.reports.honest import honest_table, split_half
from fl3d.reports.table import Table
from fl3d.reports.write import write_tables
from fl3d.rescore import stored_with_validation
from fl3d.results import results_folder

HALVINGS = 100


def write_honest(config: Config, scores: pd.DataFrame) -> tuple[Table, list[Path]]:
    """The table of last, best and honest best, and the figure of the best of k checkpoints."""
    trials = list(scores[scores["step"] > scores["first_own_step"]].groupby("trial"))
    shown = tqdm(trials, desc="halves", unit="trial", leave=False, disable=None)
    halved = pd.DataFrame([_halved(config, str(trial), own) for trial, own in shown])
    stages = config["selection"]["stages"]
    notes = (f"{HALVINGS} random halvings of the validation frames, each in both directions.",)
    table = honest_table(scores, halved, stages, notes)
    folder = results_folder(config)
    written = write_tables([table], folder)
    written += best_of_k_figure(scores, folder / "figures" / "best_of_k")
    return table, written


def _halved(config: Config, trial: str, own: pd.DataFrame) -> dict[str, object]:
    """3D AP moderate of the checkpoint that a half chooses, on it and on the other half."""
    paths = StagePaths(Path(config["store"]["root"]) / "stages" / trial)
    protocol = Protocol(**config["protocol"])
    seen: dict[tuple[str, ...], Validation] = {}
    sides: np.ndarray | None = None
    means, moderate = [], []
    for step in sorted(own["step"]):
        comparison = compare_stored(*stored_with_validation(paths, seen, int(step)), protocol)
        matches = {level: comparison.matches("Car", "3d", level) for level in DIFFICULTIES}
        if sides is None:
            sides = _halves(len(matches["moderate"].n_gt))
        flat = sides.reshape(-1, sides.shape[2])
        aps = {level: resampled_aps(m, flat)[:, 0].reshape(2, HALVINGS) for level, m in matches.items()}
        means.append(np.mean(list(aps.values()), axis=0))
        moderate.append(aps["moderate"])
    chosen, other = split_half(np.stack(means, axis=-1), np.stack(moderate, axis=-1))
    return {"trial": trial, "chosen": chosen, "other": other}


def _halves(n_frames: int) -> np.ndarray:
    """Which frames are on each side: (2, R, F) of 0 and 1."""
    rng, first = np.random.default_rng([0, n_frames]), np.zeros((HALVINGS, n_frames), dtype=np.int64)
    for row in first:
        row[rng.permutation(n_frames)[: n_frames // 2]] = 1
    return np.stack([first, 1 - first])
