"""Windows of several checkpoints, and of several frames at once, are those of each alone."""

from pathlib import Path

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Detector
from fl3d.inference.load import build_detector
from fl3d.inference.windows import collect_windows


def network(seed: int, name: str = "voxelnet") -> Detector:
    torch.manual_seed(seed)
    return build_detector(compose_config([f"detector={name}", "profile=tiny"]))


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


@pytest.mark.parametrize("name", ["voxelnet", "fcn3d"])
def test_frames_at_once_have_the_windows_of_each_in_their_order(name: str, simulated: Path) -> None:
    """Up to rounding; three frames in batches of two, so that the last has one."""
    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("train")[:3], 0)
    one, two = (collect_windows([network(0, name)], frames, batch_size=n)[0] for n in (1, 2))
    assert one.frames == two.frames == 3
    assert len(one.positive) > 0
    np.testing.assert_allclose(two.positive, one.positive, rtol=0, atol=1e-4)
    np.testing.assert_allclose(two.negative, one.negative, rtol=0, atol=1e-4)


def test_negatives_are_sampled_of_each_batch_as_many_as_its_frames_may_have(
    simulated: Path,
) -> None:
    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("train")[:3], 0)
    (found,) = collect_windows([network(0)], frames, batch_size=2, most_negative=300)
    assert len(found.negative) == 300
