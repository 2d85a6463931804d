"""The paper's claims beside our store: gains, best models, hard windows, posteriors, and what the networks are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from torch import nn

from fl3d.config import compose_config
from fl3d.data.kitti import KittiFolder
from fl3d.data.voxels import occupancy
from fl3d.detectors.fcn3d import FCN3D
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.records import Config, StagePaths
from fl3d.reports.claims import Claim, best_claim, claims_table, gain_claims, step_claims
from fl3d.reports.figures.windows import BINS, cumulative_loss
from fl3d.reports.selection import select
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.reports.tables import best_pairs
from fl3d.rescore import finished_trials, front, stage_at
from fl3d.training.build import build_detector
from fl3d.training.windows import windows_of

HARDEST = 0.15  # of the positives, that carry half of their loss
LOOKED_AT = 100  # frames that voxels and windows are counted on


def claims_of(config: Config, scores: pd.DataFrame) -> Table:
    """All claims about gains, windows and networks, as a table."""
    trials, stages = finished_trials(config), config["selection"]["stages"]
    claims = gain_claims(_last_aps(scores))
    claims += [best_claim(best_pairs(scores, stages)), *step_claims()]
    claims += [_half_of_loss(config, scores), *_posteriors(trials), *_networks(trials[0])]
    notes = (
        "What ours are is said below each table; 3D-FCN and VoxelNet at full size where windows and layers count.",
    )
    return claims_table(claims, notes)


def _last_aps(scores: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """APs of last models, seeds averaged: by detector, a row a gamma."""
    last, metrics = select(scores, "last"), list(AP_COLUMNS.values())
    renamed = {metric: column for column, metric in AP_COLUMNS.items()}
    return {
        str(detector): own.groupby("gamma")[metrics].mean().rename(columns=renamed)
        for detector, own in last.groupby("detector")
    }


def _half_of_loss(config: Config, scores: pd.DataFrame) -> Claim:
    """The hardest 15 % of 3D-FCN's positives account for half of the positive loss (§VI-B, its best focal model)."""
    stages = config["selection"]["stages"]
    pairs = best_pairs(scores, stages)
    pairs = pairs[(pairs["detector"] == "3D-FCN") & (pairs["gamma"] > 0)]
    share = ""
    if len(pairs):
        gamma = float(pairs.iloc[0]["gamma"])
        chosen = select(scores, "best", stages)
        found = chosen[(chosen["detector"] == "3D-FCN") & (chosen["gamma"] == gamma)].sort_values("seed").iloc[0]
        paths = StagePaths(Path(config["store"]["root"]) / "stages" / str(found["trial"]))
        logits = windows_of(stage_at(paths, int(found["step"])), int(found["step"])).positive
        shares = [1 - float(cumulative_loss(logits, 1, g, np.array([1 - HARDEST]))[0]) for g in (0.0, gamma)]
        share = f"{shares[0]:.0%} under γ = 0, {shares[1]:.0%} under γ = {gamma:g}"
    text = "share of the positive loss on the 15 % hardest positives of 3D-FCN"
    verdict = "" if not share else "ours: " + ("about half" if 0.4 < shares[0] < 0.6 else "not half")
    return Claim("§VI-B", text, "roughly half", "", share, verdict)


def _posteriors(trials: Sequence[StagePaths]) -> list[Claim]:
    """As gamma grows, posteriors of positives fall (§VI-C, Figure 5)."""
    rows = []
    for paths in trials:
        trial = front(paths)
        logits = windows_of(paths, trial["step"]).positive.astype(np.float64)
        p = 1 / (1 + np.exp(-logits))
        density, edges = np.histogram(p, bins=BINS, range=(0, 1))
        peak = {"peak": density.max() / len(p) * BINS, "place": float(edges[density.argmax()] + 0.5 / BINS)}
        rows.append({**trial, **peak, "median": float(np.median(p))})
    found = []
    for detector, own in pd.DataFrame(rows).groupby("detector"):
        means = own.groupby("gamma")[["median", "peak", "place"]].mean()
        medians, peaks, places = means["median"], means["peak"], means["place"]
        falls, steps = int((np.diff(medians) < 0).sum()), len(medians) - 1
        trend = f"the median falls in {falls} of {steps} steps of γ"
        first, last = (f"{medians.iloc[i]:.3f} (γ = {medians.index[i]:g})" for i in (0, -1))
        ends = f"median {first} to {last}; peak {peaks.iloc[0]:.1f} at {places.iloc[0]:.2f} to {peaks.iloc[-1]:.1f}"
        ends += f" at {places.iloc[-1]:.2f}"
        text = f"the peak of the posteriors of {detector}'s positives decreases and moves lower as γ grows"
        found.append(Claim("§VI-C, Fig. 5", text, "decreases", "", ends, f"ours: {trend}"))
    return found


def _networks(paths: StagePaths) -> list[Claim]:
    """Windows, layers and voxels of the networks at full size, on frames of the sweep's own data."""
    fcn, voxelnet = (build_detector(compose_config([f"detector={d}", "profile=paper"])) for d in ("fcn3d", "voxelnet"))
    assert isinstance(fcn, FCN3D)
    assert isinstance(voxelnet, VoxelNet)
    layers = [m for m in voxelnet.modules() if isinstance(m, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d)]
    convolutions = len(layers) - 2  # the heads are not counted
    spec = json.loads(paths.spec.read_text())
    data, machine = spec["stage"]["config"]["data"], spec["machine"]
    kitti = KittiFolder(Path(machine["data_root"]), data["crop"], data["calibration"])
    voxels, positives = [], []
    for frame_id in machine["train_ids"][:LOOKED_AT]:
        frame = kitti.frame(frame_id)
        voxels.append(len(occupancy(frame.points_velo, voxelnet.grid)))
        positives.append(len(voxelnet.encode(frame, np.random.default_rng(0), training=True)["positive"]))
    cells, n_cells, n_anchors = int(np.prod(voxelnet.grid.shape)), int(np.prod(fcn.cells)), len(voxelnet.anchors)
    few = np.mean(np.array(positives) < 30)
    rows = (
        ("§III-B", "windows a frame, 3D-FCN", "50k", "", f"{n_cells:,}", _holds(n_cells // 1000 == 50)),
        ("§III-B", "windows a frame, VoxelNet", "70k", "", f"{n_anchors:,}", _holds(n_anchors // 1000 == 70)),
        (
            "§III-B",
            "positive windows a frame, VoxelNet",
            "less than 30",
            "",
            f"{np.mean(positives):.1f}, at most {max(positives)}",
            f"ours: less than 30 in {few:.0%} of the frames",
        ),
        ("§V-B", "convolution layers, VoxelNet, no heads", "22", "", str(convolutions), _holds(convolutions == 22)),
        (
            "§V-A",
            "voxels that hold points, VoxelNet",
            "5300, 0.3 %",
            f"5300 of {cells:,}: {5300 / cells:.2%}",
            f"{np.mean(voxels):.0f}, {np.mean(voxels) / cells:.2%}",
            "printed cut off, not rounded" if 0.00345 <= 5300 / cells < 0.004 else "",
        ),
    )
    return [Claim(*row) for row in rows]


def _holds(is_so: bool) -> str:
    return "holds" if is_so else "does not hold here"
