"""In single precision, sparse layers are as near to the truth as dense ones."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from fl3d.config.compose import compose_config
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.blocks import scatter_dense
from fl3d.inference.load import build_detector
from fl3d.sparse import layers
from fl3d.sparse.background import BackgroundMap, dense


def outputs(kitti: Path, detector: str, size: str) -> tuple[Tensor, Tensor, Tensor]:
    """What the 3D convolutions make of a real frame: dense and sparse in float32, sparse in float64."""
    torch.manual_seed(0)
    model = build_detector(compose_config([f"detector={detector}", f"profile={size}"])).train()
    sample = model.encode(
        KittiFolder(kitti).frame("000007"), np.random.default_rng(0), training=False
    )
    batch = model.collate([sample])
    cells = batch["cells" if detector == "voxelnet" else "occupied"]
    network = model.middle if detector == "voxelnet" else model.body
    assert isinstance(network, torch.nn.Module)
    with torch.no_grad():
        values = (
            model.feature_net(batch["rows"], batch["lengths"], None)
            if detector == "voxelnet"
            else None
        )  # type: ignore[operator]
        values = torch.ones(len(cells), 1) if values is None else values
        grid = model.grid.shape  # type: ignore[union-attr]
        full = scatter_dense(values, cells, (1, *grid)).clone(memory_format=torch.contiguous_format)
        found = [network(full), dense(network(BackgroundMap.from_voxels(values, batch["layout"])))]
        exact = dense(network.double()(BackgroundMap.from_voxels(values.double(), batch["layout"])))
    return found[0], found[1], exact


@pytest.mark.parametrize("detector", ["voxelnet", "fcn3d"])
@pytest.mark.parametrize("size", ["quick", pytest.param("paper", marks=pytest.mark.slow)])
def test_the_error_is_at_most_twice_that_of_dense_contiguous(
    detector: str, size: str, kitti_sample: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layers, "DENSE_FROM", float("inf"))
    contiguous, sparse, exact = outputs(kitti_sample, detector, size)
    errors = [
        float((out.double() - exact).abs().max() / exact.abs().max())
        for out in (contiguous, sparse)
    ]
    assert errors[1] <= 2 * errors[0], errors
    assert errors[0] < 1e-4
