"""Figures 1, 4 and 5 of the paper, and the imbalance by height (§III-B), of a sweep over gamma."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from fl3d.config.compose import compose_config
from fl3d.core.errors import StoreError
from fl3d.detectors.fcn3d import FCN3D
from fl3d.inference.load import build_detector
from fl3d.inference.windows import windows_of
from fl3d.papers.base import with_values
from fl3d.papers.focal_loss.tables import GAMMA, LAST_TABLES, best_pairs, gamma_of, is_over_gamma
from fl3d.papers.focal_loss.window_figures import figure_4, figure_5, imbalance_by_height
from fl3d.papers.scenes import scenes_of
from fl3d.reports.figures.boxes import Scene, boxes_of_models
from fl3d.reports.levels import slug
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec

COUNTED = 1000  # training frames over which positives by height are counted
FIRST_SEED = "Models of the first seed of training that each γ has."
CAPTIONS = {
    "figure_1_3dfcn": "Figure 1. 3D-FCN: BCE above, focal loss below; ground truth purple, estimates blue. "
    f"{FIRST_SEED}",
    "figure_1_voxelnet": "Figure 1. VoxelNet: BCE above, focal loss below; ground truth purple, estimates blue. "
    f"{FIRST_SEED}",
    "figure_4": "Figure 4. Cumulative normalised loss of the best focal models' windows, under each γ. "
    f"{FIRST_SEED}",
    "figure_5": "Figure 5. Posterior probability of positive windows, last models; of each γ the windows of all its "
    "seeds of training, pooled.",
    "imbalance_by_height": "Positive windows of 3D-FCN by height, and how many negatives stand against each (§III-B); "
    "of labels and windows alone, no model is asked.",
}


def draw(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Draw the paper's figures of a sweep over gamma; every file written, none for other sweeps.

    Args:
        sweep: its run folders must be at hand.
        folder: of the figures.
    """
    detectors = {trial.detector for trial in sweep.trials}
    if not is_over_gamma(sweep) or not detectors & set(LAST_TABLES):
        return []
    written = _posteriors(sweep, folder)
    written += _cumulative_losses(sweep, folder)
    written += imbalance_by_height(_heights(sweep), folder / "imbalance_by_height")
    return written + _scenes(sweep, folder)


def _posteriors(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 5, of the last models; seeds are pooled."""
    pooled: dict[tuple[str, float], list[np.ndarray]] = {}
    for trial in sweep.trials:
        logits = windows_of(sweep, trial.folder, trial.last_step).positive.astype(np.float64)
        pooled.setdefault((trial.detector, gamma_of(trial.plan)), []).append(
            1 / (1 + np.exp(-logits))
        )
    return figure_5({key: np.concatenate(own) for key, own in pooled.items()}, folder / "figure_5")


def _cumulative_losses(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 4, of the best focal models (Table IV, rows 2 and 4), their first seed."""
    sampled = {}
    for detector, trial, step, gamma in _best(sweep):
        if gamma > 0:
            windows = windows_of(sweep, sweep.trial(trial).holder(step), step)
            sampled[detector] = (windows.positive, windows.negative)
    gammas = sorted({gamma_of(trial.plan) for trial in sweep.trials})
    return figure_4(sampled, gammas, folder / "figure_4")


def _best(sweep: FinishedSweep) -> list[tuple[str, str, int, float]]:
    """Detector, trial, step and gamma of the models of Table IV; of several seeds the first."""
    chosen = with_values(sweep, sweep.select("best"), {"gamma": GAMMA})
    chosen = chosen.assign(gamma=chosen["gamma"].astype(float))
    found = []
    for _, pair in best_pairs(sweep).iterrows():
        same = chosen[(chosen["detector"] == pair["detector"]) & (chosen["gamma"] == pair["gamma"])]
        first = same.sort_values("seed").iloc[0]
        found.append(
            (str(first["detector"]), str(first["trial"]), int(first["step"]), float(first["gamma"]))
        )
    return found


def _heights(sweep: FinishedSweep) -> pd.DataFrame:
    """Positive and negative windows of 3D-FCN's full grid, a frame, by height; over training frames of the sweep."""
    kitti = sweep.kitti()
    detector = build_detector(compose_config(["detector=fcn3d", "profile=paper"]))
    if not isinstance(detector, FCN3D):
        raise StoreError("conf/detector/fcn3d.yaml no longer builds 3D-FCN")
    nz, ny, nx = detector.cells
    ids = read_spec(sweep.trials[0].folder).machine.train_ids[:COUNTED]
    counts = np.zeros(nz)
    for frame_id in ids:
        cells, _ = detector.assign(detector.targets.boxes_velo(kitti.frame(frame_id)))
        counts += np.bincount(cells[:, 0], minlength=nz)
    rows = np.stack([np.arange(nz), np.zeros(nz), np.zeros(nz)], axis=1).astype(np.int64)
    low = detector.origins(rows)[:, 2]
    positives = counts / len(ids)
    return pd.DataFrame(
        {
            "z_low": low,
            "z_high": low + low[1] - low[0],
            "positives": positives,
            "negatives": ny * nx - positives,
        }
    )


def _scenes(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 1 of each detector: its best models with BCE and with the focal loss, on the frames with most cars."""
    models: dict[str, dict[str, list[Scene]]] = {}
    for detector, trial, step, gamma in _best(sweep):
        label = f"{detector}, BCE" if gamma == 0 else f"{detector}, focal loss, γ = {gamma:g}"
        models.setdefault(detector, {})[label] = scenes_of(
            sweep, sweep.trial(trial).holder(step), step
        )
    written: list[Path] = []
    for detector, pair in models.items():
        name = f"figure_1_{slug(detector).replace('-', '')}"
        written += boxes_of_models(pair, sweep.protocol.ignore_beyond, folder / name)
    return written
