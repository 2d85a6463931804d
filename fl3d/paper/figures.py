"""All figures of a sweep, from its store."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from fl3d.config import compose_config
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.fcn3d import FCN3D
from fl3d.errors import StoreError
from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.evaluation.protocol import Protocol
from fl3d.gains import comparable, compare_sweep, gains
from fl3d.paper.index import write_index
from fl3d.paper.report_figures import feeds, scenes_of, write_report_figures
from fl3d.records import Config, StagePaths
from fl3d.reports.figures.boxes import Scene, figure_1
from fl3d.reports.figures.curves import ap_over_cut, ap_over_gamma, ap_over_steps, precision_recall
from fl3d.reports.figures.windows import figure_4, figure_5, imbalance_by_height
from fl3d.reports.selection import select
from fl3d.reports.tables import LAST_TABLES, best_pairs
from fl3d.rescore import finished_trials, front, rescore, stage_at
from fl3d.results import results_folder, scores_of
from fl3d.training.build import build_detector
from fl3d.training.windows import windows_of

CUTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)


def write_figures(overrides: list[str], say: Callable[[str], None] = print) -> list[Path]:
    """Draw Figures 1, 4 and 5, AP against steps, gamma and score cut, precision and recall, the imbalance by height.

    Args:
        overrides: of the config; the sweep must be one over gamma (default: ``+sweep=gamma``).
        say: prints a line for the user.

    Raises:
        StoreError: the sweep was never run here, or is not one over gamma.
    """
    chosen = any(override.startswith("+sweep=") for override in overrides)
    config = compose_config(overrides if chosen else [*overrides, "+sweep=gamma"])
    if feeds(config):
        return write_report_figures(config, say)
    if not set(config["sweep"]["tables"]) & set(LAST_TABLES):
        raise StoreError(
            f"sweep {config['sweep']['name']}: the figures are of a sweep over gamma, such as +sweep=gamma"
        )
    trials, scores = finished_trials(config), scores_of(config)
    folder, stages = results_folder(config) / "figures", config["selection"]["stages"]
    compared = compare_sweep(config)
    written = ap_over_steps(scores, folder / "ap_over_steps", stages)
    written += ap_over_gamma(scores, folder / "ap_over_gamma", gains(comparable(compared)))
    written += ap_over_cut(rescore(config, {"score_threshold": CUTS}), folder / "ap_over_cut")
    rows = []
    for (detector, gamma), by_seed in sorted(compared.items()):
        precision = np.mean([c.curve("Car", "3d", "moderate").precision for c in by_seed.values()], axis=0)
        recall = np.arange(N_SAMPLES) / (N_SAMPLES - 1)
        rows.append(pd.DataFrame({"detector": detector, "gamma": gamma, "recall": recall, "precision": precision}))
    written += precision_recall(pd.concat(rows, ignore_index=True), folder / "precision_recall")
    written += _posteriors(trials, folder)
    written += _cumulative_losses(config, scores, folder)
    written += imbalance_by_height(_heights(trials[0]), folder / "imbalance_by_height")
    written += _scenes(config, scores, folder)
    write_index(Path(config["results"]))
    say(f"Written to {folder}: " + ", ".join(path.name for path in written))
    return written


def _posteriors(trials: list[StagePaths], folder: Path) -> list[Path]:
    """Figure 5, of the last models; seeds are pooled."""
    pooled: dict[tuple[str, float], list[np.ndarray]] = {}
    for paths in trials:
        trial = front(paths)
        logits = windows_of(paths, trial["step"]).positive.astype(np.float64)
        pooled.setdefault((trial["detector"], trial["gamma"]), []).append(1 / (1 + np.exp(-logits)))
    return figure_5({key: np.concatenate(own) for key, own in pooled.items()}, folder / "figure_5")


def _cumulative_losses(config: Config, scores: pd.DataFrame, folder: Path) -> list[Path]:
    """Figure 4, of the best focal models (Table IV, rows 2 and 4), their first seed."""
    sampled = {}
    for detector, trial, step, gamma in _best(config, scores):
        if gamma > 0:
            found = windows_of(stage_at(StagePaths(Path(config["store"]["root"]) / "stages" / trial), step), step)
            sampled[detector] = found.positive, found.negative
    return figure_4(sampled, sorted(scores["gamma"].unique()), folder / "figure_4")


def _best(config: Config, scores: pd.DataFrame) -> list[tuple[str, str, int, float]]:
    """Detector, trial, step and gamma of the models of Table IV; of several seeds the first."""
    stages = config["selection"]["stages"]
    chosen, found = select(scores, "best", stages), []
    for _, pair in best_pairs(scores, stages).iterrows():
        same = chosen[(chosen["detector"] == pair["detector"]) & (chosen["gamma"] == pair["gamma"])]
        first = same.sort_values("seed").iloc[0]
        found.append((str(first["detector"]), str(first["trial"]), int(first["step"]), float(first["gamma"])))
    return found


def _heights(paths: StagePaths) -> pd.DataFrame:
    """Positive and negative windows of 3D-FCN's full grid, a frame, by height; over the training frames of a trial."""
    spec = json.loads(paths.spec.read_text())
    data, machine = spec["stage"]["config"]["data"], spec["machine"]
    folder = KittiFolder(Path(machine["data_root"]), data["crop"], data["calibration"])
    detector = build_detector(compose_config(["detector=fcn3d", "profile=paper"]))
    assert isinstance(detector, FCN3D)
    nz, ny, nx = detector.cells
    ids = machine["train_ids"][:1000]
    counts = np.zeros(nz)
    for frame_id in ids:
        cells, _ = detector.assign(detector.targets.boxes_velo(folder.frame(frame_id)))
        counts += np.bincount(cells[:, 0], minlength=nz)
    low = detector.origins(np.stack([np.arange(nz), np.zeros(nz), np.zeros(nz)], axis=1).astype(np.int64))[:, 2]
    step = low[1] - low[0]
    positives = counts / len(ids)
    return pd.DataFrame({"z_low": low, "z_high": low + step, "positives": positives, "negatives": ny * nx - positives})


def _scenes(config: Config, scores: pd.DataFrame, folder: Path) -> list[Path]:
    """Figure 1 of each detector: its best models with BCE and with the focal loss, on the frames with most cars."""
    written: list[Path] = []
    models: dict[str, dict[str, list[Scene]]] = {}
    for detector, trial, step, gamma in _best(config, scores):
        paths = stage_at(StagePaths(Path(config["store"]["root"]) / "stages" / trial), step)
        scenes = scenes_of(config, paths, step)
        label = f"{detector}, BCE" if gamma == 0 else f"{detector}, focal loss, γ = {gamma:g}"
        models.setdefault(detector, {})[label] = scenes
    for detector, pair in models.items():
        name = f"figure_1_{detector.lower().replace('-', '')}"
        written += figure_1(pair, Protocol(**config["protocol"]).ignore_beyond, folder / name)
    return written
