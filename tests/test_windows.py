"""Windows of several checkpoints, in one pass over the frames, are those of each alone."""

from pathlib import Path

import numpy as np
import torch

from fl3d.config.compose import compose_config
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Detector
from fl3d.inference.load import build_detector
from fl3d.inference.windows import collect_windows


def network(seed: int) -> Detector:
    torch.manual_seed(seed)
    return build_detector(compose_config(["detector=voxelnet", "profile=tiny"]))


def test_several_networks_give_what_each_gives_alone(simulated: Path) -> None:
    """Also where negatives are sampled, a third of a frame's and others in each frame."""
    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("train")[:3], 0)
    networks = [network(0), network(1)]
    most = {"most_positive": 4, "most_negative": 300}
    together = collect_windows(networks, frames, **most)
    for one, found in zip(networks, together, strict=True):
        (alone,) = collect_windows([one], frames, **most)
        np.testing.assert_array_equal(found.positive, alone.positive)
        np.testing.assert_array_equal(found.negative, alone.negative)
        assert len(found.positive) <= 4
        assert len(found.negative) == 300
    assert not np.array_equal(together[0].negative, together[1].negative)
