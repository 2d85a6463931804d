"""Benchmarks measure what they say: parts of them that can be wrong by themselves."""

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.networks import build, middle
from fl3d.data.kitti import KittiFolder


@pytest.mark.parametrize("compute", ["dense", "sparse"])
def test_the_middle_layers_take_as_many_frames_as_a_batch_has(
    compute: str, simulated: Path
) -> None:
    """Also where the maps are dense from the start, so that the batch has no layout."""
    model = build("voxelnet", compute, "tiny").eval()
    folder = KittiFolder(simulated)
    frames = [folder.frame(frame_id) for frame_id in folder.split("train")[:2]]
    samples = [model.encode(frame, np.random.default_rng(0), training=True) for frame in frames]

    def features(*chosen: int) -> torch.Tensor:
        batch = model.collate([samples[i] for i in chosen])
        with torch.no_grad():
            voxels = model.feature_net(batch["rows"], batch["lengths"], batch.get("mask"))
            return middle(model, voxels, batch)

    torch.testing.assert_close(features(0, 1), torch.cat([features(0), features(1)]))
