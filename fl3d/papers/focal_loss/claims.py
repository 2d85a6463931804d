"""The paper's claims beside our store: gains, best models, hard windows, posteriors, and what the networks are."""

from __future__ import annotations

import numpy as np
import pandas as pd
from torch import nn

from fl3d.config.compose import compose_config
from fl3d.data.voxels import occupancy
from fl3d.detectors.fcn3d import FCN3D
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.inference.load import build_detector
from fl3d.inference.windows import windows_of
from fl3d.papers.base import with_values
from fl3d.papers.focal_loss.gain_claims import (
    Claim,
    best_claim,
    claims_table,
    gain_claims,
    step_claims,
)
from fl3d.papers.focal_loss.tables import GAMMA, best_pairs, gamma_of, is_over_gamma
from fl3d.papers.focal_loss.window_figures import BINS, cumulative_loss
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec

HARDEST = 0.15  # of the positives, that carry half of their loss
LOOKED_AT = 100  # frames that voxels and windows are counted on


def claims_of(sweep: FinishedSweep) -> Table | None:
    """All claims about gains, windows and networks, as a table; None for a sweep that is not over gamma.

    Args:
        sweep: over gamma; its run folders must be at hand.
    """
    if not is_over_gamma(sweep):
        return None
    claims = gain_claims(_last_aps(sweep))
    claims += [best_claim(best_pairs(sweep)), *step_claims()]
    claims += [_half_of_loss(sweep), *_posteriors(sweep), *_networks(sweep)]
    notes = (
        "What ours are is said below each table; 3D-FCN and VoxelNet at full size where windows and layers count.",
    )
    return claims_table(claims, notes)


def _last_aps(sweep: FinishedSweep) -> dict[str, pd.DataFrame]:
    """APs of last models, seeds averaged: by detector, a row a gamma."""
    last = with_values(sweep, sweep.select("last"), {"gamma": GAMMA})
    last = last.assign(gamma=last["gamma"].astype(float))
    metrics = list(AP_COLUMNS.values())
    renamed = {metric: column for column, metric in AP_COLUMNS.items()}
    return {
        str(detector): own.groupby("gamma")[metrics].mean().rename(columns=renamed)
        for detector, own in last.groupby("detector")
    }


def _half_of_loss(sweep: FinishedSweep) -> Claim:
    """The hardest 15 % of 3D-FCN's positives account for half of the positive loss (§VI-B, its best focal model)."""
    text = "share of the positive loss on the 15 % hardest positives of 3D-FCN"
    pairs = best_pairs(sweep)
    pairs = pairs[(pairs["detector"] == "3D-FCN") & (pairs["gamma"] > 0)] if len(pairs) else pairs
    if pairs.empty:
        return Claim("§VI-B", text, "roughly half", "", "", "")
    gamma = float(pairs.iloc[0]["gamma"])
    chosen = with_values(sweep, sweep.select("best"), {"gamma": GAMMA})
    chosen = chosen[(chosen["detector"] == "3D-FCN") & (chosen["gamma"].astype(float) == gamma)]
    first = chosen.sort_values("seed").iloc[0]
    step = int(first["step"])
    logits = windows_of(sweep.trial(str(first["trial"])).holder(step), step).positive
    shares = [
        1 - float(cumulative_loss(logits, 1, g, np.array([1 - HARDEST]))[0]) for g in (0.0, gamma)
    ]
    share = f"{shares[0]:.0%} under γ = 0, {shares[1]:.0%} under γ = {gamma:g}"
    verdict = "ours: about half" if 0.4 < shares[0] < 0.6 else "ours: not half"
    return Claim("§VI-B", text, "roughly half", "", share, verdict)


def _posteriors(sweep: FinishedSweep) -> list[Claim]:
    """As gamma grows, posteriors of positives fall (§VI-C, Figure 5)."""
    rows = []
    for trial in sweep.trials:
        logits = windows_of(trial.folder, trial.last_step).positive.astype(np.float64)
        p = 1 / (1 + np.exp(-logits))
        density, edges = np.histogram(p, bins=BINS, range=(0, 1))
        row = {
            "detector": trial.detector,
            "gamma": gamma_of(trial.plan),
            "median": float(np.median(p)),
        }
        row["peak"] = density.max() / len(p) * BINS
        row["place"] = float(edges[density.argmax()] + 0.5 / BINS)
        rows.append(row)
    found = []
    for detector, own in pd.DataFrame(rows).groupby("detector"):
        means = own.groupby("gamma")[["median", "peak", "place"]].mean()
        medians = means["median"]
        peaks = means["peak"]
        places = means["place"]
        falls = int((np.diff(medians) < 0).sum())
        steps = len(medians) - 1
        trend = f"the median falls in {falls} of {steps} steps of γ"
        first, last = (f"{medians.iloc[i]:.3f} (γ = {medians.index[i]:g})" for i in (0, -1))
        ends = f"median {first} to {last}; peak {peaks.iloc[0]:.1f} at {places.iloc[0]:.2f} to {peaks.iloc[-1]:.1f}"
        ends += f" at {places.iloc[-1]:.2f}"
        text = f"the peak of the posteriors of {detector}'s positives decreases and moves lower as γ grows"
        found.append(Claim("§VI-C, Fig. 5", text, "decreases", "", ends, f"ours: {trend}"))
    return found


def _networks(sweep: FinishedSweep) -> list[Claim]:
    """Windows, layers and voxels of the networks at full size, on frames of the sweep's own data."""
    fcn, voxelnet = (
        build_detector(compose_config([f"detector={d}", "profile=paper"]))
        for d in ("fcn3d", "voxelnet")
    )
    assert isinstance(fcn, FCN3D)
    assert isinstance(voxelnet, VoxelNet)
    layers = [
        m for m in voxelnet.modules() if isinstance(m, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d)
    ]
    convolutions = len(layers) - 2  # the heads are not counted
    kitti = sweep.kitti()
    voxels = []
    positives = []
    for frame_id in read_spec(sweep.trials[0].folder).machine.train_ids[:LOOKED_AT]:
        frame = kitti.frame(frame_id)
        voxels.append(len(occupancy(frame.points_velo, voxelnet.grid)))
        positives.append(
            len(voxelnet.encode(frame, np.random.default_rng(0), training=True)["positive"])
        )
    cells, n_cells, n_anchors = (
        int(np.prod(voxelnet.grid.shape)),
        int(np.prod(fcn.cells)),
        len(voxelnet.anchors),
    )
    few = np.mean(np.array(positives) < 30)
    rows = (
        (
            "§III-B",
            "windows a frame, 3D-FCN",
            "50k",
            "",
            f"{n_cells:,}",
            _holds(n_cells // 1000 == 50),
        ),
        (
            "§III-B",
            "windows a frame, VoxelNet",
            "70k",
            "",
            f"{n_anchors:,}",
            _holds(n_anchors // 1000 == 70),
        ),
        (
            "§III-B",
            "positive windows a frame, VoxelNet",
            "less than 30",
            "",
            f"{np.mean(positives):.1f}, at most {max(positives)}",
            f"ours: less than 30 in {few:.0%} of the frames",
        ),
        (
            "§V-B",
            "convolution layers, VoxelNet, no heads",
            "22",
            "",
            str(convolutions),
            _holds(convolutions == 22),
        ),
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
