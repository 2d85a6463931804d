"""Sentences of the paper about its networks at full size: windows, layers and voxels."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import nn

from fl3d.data.frame_digests import data_digest
from fl3d.data.voxels import occupancy
from fl3d.detectors.fcn3d import FCN3D
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.inference.load import build_detector
from fl3d.papers.claim import Claim
from fl3d.papers.focal_loss.full_size import full_size
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, kept
from fl3d.runs.layout import StoreFolder
from fl3d.runs.spec import read_spec

LOOKED_AT = 100  # frames that voxels and windows are counted on
HERE = ("papers/focal_loss/network_claims.py",)


def network_claims(sweep: FinishedSweep) -> list[Claim]:
    """Windows, layers and voxels of the networks at full size, on frames of the sweep's own data."""
    found = _counts(sweep)
    positives, voxels = found["positives"], found["voxels"]
    cells, n_cells, n_anchors, convolutions = (
        int(found[name]) for name in ("cells", "windows_fcn3d", "windows_voxelnet", "convolutions")
    )
    few = np.mean(positives < 30)
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


def _counts(sweep: FinishedSweep) -> Arrays:
    """What is counted: kept, for to build both networks takes longer than all other claims."""
    kitti = sweep.kitti()
    spec = read_spec(sweep.trials[0].folder)
    ids = spec.machine.train_ids[:LOOKED_AT]
    configs = [full_size(d) for d in ("fcn3d", "voxelnet")]

    def make() -> Arrays:
        fcn, voxelnet = (build_detector(config) for config in configs)
        assert isinstance(fcn, FCN3D)
        assert isinstance(voxelnet, VoxelNet)
        kinds = nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d
        layers = [module for module in voxelnet.modules() if isinstance(module, kinds)]
        voxels, positives = [], []
        for frame_id in ids:
            frame = kitti.frame(frame_id)
            voxels.append(len(occupancy(frame.points_velo, voxelnet.grid)))
            sample = voxelnet.encode(frame, np.random.default_rng(0), training=True)
            positives.append(len(sample["positive"]))
        counts: dict[str, Any] = {
            "voxels": voxels,
            "positives": positives,
            "cells": np.prod(voxelnet.grid.shape),
            "windows_fcn3d": np.prod(fcn.cells),
            "windows_voxelnet": len(voxelnet.anchors),
            "convolutions": len(layers) - 2,  # the heads are not counted
        }
        return {name: np.array(count) for name, count in counts.items()}

    made_of = {
        "frames": data_digest(kitti, ids),
        "read": spec.stage.config["data"],
        "configs": [{key: one[key] for key in ("detector", "loss")} for one in configs],
        "code": code_digest("geometry", "data", "losses.py", "sparse", "detectors", *HERE),
    }
    return kept(StoreFolder(sweep.settings.store.root).kept("full_size"), made_of, make)


def _holds(is_so: bool) -> str:
    return "holds" if is_so else "does not hold here"
