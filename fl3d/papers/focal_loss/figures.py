"""Figures 1, 4 and 5 of the paper, Figure 1 of its arXiv version, and the imbalance by height: of a sweep over γ."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.ahead import Job, window_jobs
from fl3d.analysis.contributions import Contributions
from fl3d.core.errors import StoreError
from fl3d.data.frame_digests import data_digest
from fl3d.detectors.fcn3d import FCN3D
from fl3d.inference.kept_windows import Place, positives_of, windows_of
from fl3d.inference.load import build_detector
from fl3d.papers.base import Feeding, with_values
from fl3d.papers.focal_loss.best_models import BEST_OWN_MODELS, best_pairs
from fl3d.papers.focal_loss.full_size import full_size
from fl3d.papers.focal_loss.tables import GAMMA, LAST_TABLES, gamma_of, is_over_gamma
from fl3d.papers.focal_loss.window_figures import (
    BOXES,
    HITS,
    WINDOWS,
    figure_4,
    figure_5,
    focal_curves,
    imbalance_by_height,
)
from fl3d.papers.scenes import scenes_of
from fl3d.reports.figures.boxes import Scene, boxes_of_models
from fl3d.reports.levels import slug
from fl3d.runs.drawn import drawn
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, is_kept, kept
from fl3d.runs.layout import StoreFolder
from fl3d.runs.spec import read_spec
from fl3d.runs.trials import FinishedTrial

FULL_GRID = "fcn3d"
COUNTED = 1000  # training frames over which positives by height are counted
OF_LAST_STAGE = "Best models of the last stage, of the first seed of training that each γ has."
CAPTIONS = {
    "figure_1_3dfcn": "Figure 1. 3D-FCN: BCE above, focal loss below; ground truth purple, estimates blue. "
    f"{OF_LAST_STAGE}",
    "figure_1_voxelnet": "Figure 1. VoxelNet: BCE above, focal loss below; ground truth purple, estimates blue. "
    f"{OF_LAST_STAGE}",
    "figure_1_arxiv": "Figure 1 of the arXiv version. Focal loss of a window over its posterior probability, by γ; in "
    "grey the windows that are classified well. Of the formula alone, no model is asked.",
    "figure_4": "Figure 4. Cumulative normalised loss of the best focal models' windows, under each γ. "
    f"{OF_LAST_STAGE}",
    "figure_5": "Figure 5. Posterior probability of positives, last models; of each γ those of all its seeds of "
    "training, pooled. Above: all boxes that the evaluation gets, after its score cut and suppression; in the middle: "
    "of these the ones that it counts as found cars; below: windows that the labels make positive.",
    "imbalance_by_height": "Positive windows of 3D-FCN by height, and how many negatives stand against each (§III-B); "
    "of labels and windows alone, no model is asked.",
}


def draw(sweep: FinishedSweep, folder: Path, feeding: Feeding) -> list[Path]:
    """Draw the paper's figures of a sweep over gamma; every file written, none for other sweeps.

    Args:
        sweep: its run folders must be at hand.
        folder: of the figures.
        feeding: not asked; all is of this sweep.
    """
    if not _is_drawn(sweep):
        return []
    written = [path for own in FIGURES.values() for path in own(sweep, folder)]
    return written + _scenes(sweep, folder)


def jobs(place: int, sweep: FinishedSweep) -> Iterator[Job]:
    """Windows that figures and claims need, positives by height, and figures, as far as they are not kept.

    Args:
        place: of the sweep.
        sweep: its run folders must be at hand.
    """
    if _is_drawn(sweep):
        best = _best_places(sweep)
        last = [(trial.folder, trial.last_step) for trial in sweep.trials]
        yield from window_jobs(place, sweep, [*last, *best], best)
        if not is_kept(*_counted(sweep)):
            yield Job(place, 1, _positives_by_height)
        for detector in dict.fromkeys(detector for detector, *_ in _best(sweep)):
            if sweep.is_undrawn(_scenes_name(detector)):
                yield Job(place, 1, _scenes_ahead, (detector,))
        for name in FIGURES:
            if sweep.is_undrawn(name):
                yield Job(place, 1, _draw_ahead, (name,), is_last=True)


def _is_drawn(sweep: FinishedSweep) -> bool:
    return is_over_gamma(sweep) and any(trial.detector in LAST_TABLES for trial in sweep.trials)


def _best_places(sweep: FinishedSweep) -> list[Place]:
    """Checkpoints whose negative windows are looked at too: the best focal models, of all seeds."""
    places: list[Place] = []
    chosen = with_values(sweep, sweep.select(BEST_OWN_MODELS.rule), {"gamma": GAMMA})
    for detector, _, _, gamma in _best(sweep):
        is_own = (chosen["detector"] == detector) & (chosen["gamma"].astype(float) == gamma)
        own = chosen[is_own] if gamma > 0 else chosen[:0]
        for key, step in zip(own["trial"], own["step"], strict=True):
            places.append((sweep.trial(str(key)).holder(int(step)), int(step)))
    return places


def _posteriors(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 5, of the last models; seeds are pooled."""
    pooled: dict[tuple[str, str, float], list[np.ndarray]] = {}
    for trial, kind, own in posteriors_of(sweep):
        key = (trial.detector, kind, gamma_of(trial.plan))
        pooled.setdefault(key, []).append(own)
    posteriors = {key: np.concatenate(own) for key, own in pooled.items()}
    return drawn(sweep.drawn_as, folder / "figure_5", partial(figure_5, posteriors))


def posteriors_of(
    sweep: FinishedSweep,
) -> Iterator[tuple[FinishedTrial, str, NDArray[np.float64]]]:
    """Posteriors of each trial's last model, of all that may be taken for its positives: trial, kind, (N,)."""
    made = Contributions(sweep)
    for trial in sweep.trials:
        boxes = made.posteriors(trial)
        logits = positives_of(sweep, trial.folder, trial.last_step).astype(np.float64)
        yield trial, BOXES, boxes.boxes
        yield trial, HITS, boxes.hits
        yield trial, WINDOWS, 1 / (1 + np.exp(-logits))


def _cumulative_losses(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 4, of the best focal models (Table IV, rows 2 and 4; of the last stage), their first seed."""
    sampled = {}
    for detector, trial, step, gamma in _best(sweep):
        if gamma > 0:
            windows = windows_of(sweep, sweep.trial(trial).holder(step), step)
            sampled[detector] = (windows.positive, windows.negative)
    losses = partial(figure_4, sampled, _gammas(sweep))
    return drawn(sweep.drawn_as, folder / "figure_4", losses)


def _curves(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Figure 1 of the arXiv version."""
    curves = partial(focal_curves, _gammas(sweep))
    return drawn(sweep.drawn_as, folder / "figure_1_arxiv", curves)


def _imbalance(sweep: FinishedSweep, folder: Path) -> list[Path]:
    """Positives of 3D-FCN by height."""
    heights = partial(imbalance_by_height, windows_by_height(sweep))
    return drawn(sweep.drawn_as, folder / "imbalance_by_height", heights)


def _gammas(sweep: FinishedSweep) -> list[float]:
    return sorted({gamma_of(trial.plan) for trial in sweep.trials})


def _best(sweep: FinishedSweep) -> list[tuple[str, str, int, float]]:
    """Detector, trial, step and gamma of the best models of the last stage; of several seeds the first.

    Those of Table IV may be older than the focal loss that their row names.
    """
    chosen = with_values(sweep, sweep.select(BEST_OWN_MODELS.rule), {"gamma": GAMMA})
    chosen = chosen.assign(gamma=chosen["gamma"].astype(float))
    found = []
    for _, pair in best_pairs(sweep, BEST_OWN_MODELS).iterrows():
        same = chosen[(chosen["detector"] == pair["detector"]) & (chosen["gamma"] == pair["gamma"])]
        first = same.sort_values("seed").iloc[0]
        found.append(
            (str(first["detector"]), str(first["trial"]), int(first["step"]), float(first["gamma"]))
        )
    return found


def windows_by_height(sweep: FinishedSweep) -> pd.DataFrame:
    """Positive and negative windows of 3D-FCN's full grid, a frame, by height; over training frames of the sweep."""
    detector = _full_grid()
    nz, ny, nx = detector.cells
    rows = np.stack([np.arange(nz), np.zeros(nz), np.zeros(nz)], axis=1).astype(np.int64)
    low = detector.origins(rows)[:, 2]
    positives = _positives_by_height(sweep) / len(_counted_ids(sweep))
    return pd.DataFrame(
        {
            "z_low": low,
            "z_high": low + low[1] - low[0],
            "positives": positives,
            "negatives": ny * nx - positives,
        }
    )


def _full_grid() -> FCN3D:
    detector = build_detector(full_size(FULL_GRID))
    if not isinstance(detector, FCN3D):
        raise StoreError("conf/detector/fcn3d.yaml no longer builds 3D-FCN")
    return detector


def _counted_ids(sweep: FinishedSweep) -> tuple[str, ...]:
    return read_spec(sweep.trials[0].folder).machine.train_ids[:COUNTED]


def _counted(sweep: FinishedSweep) -> tuple[Path, dict[str, Any]]:
    """Where the count of positives by height is kept, and what it is made of."""
    spec = read_spec(sweep.trials[0].folder)
    return StoreFolder(sweep.settings.store.root).kept("positives_by_height"), {
        "frames": data_digest(sweep.kitti(), _counted_ids(sweep)),
        "read": spec.stage.config["data"],
        "detector": full_size(FULL_GRID)["detector"],
        "code": code_digest("geometry", "data", "detectors"),
    }


def _positives_by_height(sweep: FinishedSweep) -> NDArray[np.float64]:
    """Positive windows of 3D-FCN's full grid in all frames that are counted, by height: (Z,)."""

    def make() -> Arrays:
        kitti, detector = sweep.kitti(), _full_grid()
        counts = np.zeros(detector.cells[0])
        for frame_id in _counted_ids(sweep):
            cells, _ = detector.assign(detector.targets.boxes_velo(kitti.frame(frame_id)))
            counts += np.bincount(cells[:, 0], minlength=len(counts))
        return {"counts": counts}

    return kept(*_counted(sweep), make)["counts"]


def _scenes(sweep: FinishedSweep, folder: Path, only: str | None = None) -> list[Path]:
    """Figure 1 of each detector: its best models with BCE and with the focal loss, on the frames with most cars."""
    models: dict[str, dict[str, list[Scene]]] = {}
    for detector, trial, step, gamma in _best(sweep):
        if only in (None, detector):
            label = f"{detector}, BCE" if gamma == 0 else f"{detector}, focal loss, γ = {gamma:g}"
            models.setdefault(detector, {})[label] = scenes_of(
                sweep, sweep.trial(trial).holder(step), step
            )
    written: list[Path] = []
    for detector, pair in models.items():
        figure = partial(boxes_of_models, pair, sweep.protocol.ignore_beyond)
        written += drawn(sweep.drawn_as, folder / _scenes_name(detector), figure)
    return written


def _scenes_name(detector: str) -> str:
    return f"figure_1_{slug(detector).replace('-', '')}"


def _scenes_ahead(sweep: FinishedSweep, detector: str) -> None:
    """Draw a detector's Figure 1, which takes as long as all others together, and keep it."""
    with TemporaryDirectory() as folder:
        _scenes(sweep, Path(folder), detector)


FIGURES: Mapping[str, Callable[[FinishedSweep, Path], list[Path]]] = {
    "figure_5": _posteriors,
    "figure_4": _cumulative_losses,
    "figure_1_arxiv": _curves,
    "imbalance_by_height": _imbalance,
}


def _draw_ahead(sweep: FinishedSweep, name: str) -> None:
    """Draw one of ``FIGURES``, and keep it."""
    with TemporaryDirectory() as folder:
        FIGURES[name](sweep, Path(folder))
