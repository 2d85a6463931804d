"""Windows of several checkpoints, and of several frames at once, are those of each alone."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.data.dataset import Frames
from fl3d.data.frame_digests import input_digest
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Detector
from fl3d.inference import kept_windows
from fl3d.inference.kept_windows import (
    Place,
    make_windows,
    missing_windows,
    positives_of,
    windows_of,
)
from fl3d.inference.load import build_detector, load
from fl3d.inference.windows import Windows, collect_windows
from fl3d.papers.focal_loss import claims
from fl3d.papers.focal_loss.concentration_claims import carried
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec
from tests.support import train


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


def test_negatives_are_looked_at_where_they_are_wanted(simulated: Path) -> None:
    folder = KittiFolder(simulated)
    frames = Frames(folder, folder.split("train")[:3], 0)
    networks = [network(0), network(1)]
    whole = collect_windows(networks, frames)
    found = collect_windows(networks, frames, with_negatives=[False, True])
    for one, own in zip(found, whole, strict=True):
        np.testing.assert_array_equal(one.positive, own.positive)
    assert len(whole[0].negative) > 0
    assert len(found[0].negative) == 0
    np.testing.assert_array_equal(found[1].negative, whole[1].negative)


def test_windows_are_kept_as_far_as_they_are_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of each checkpoint the positives, of one the negatives too; who wants more finds it missing."""
    asked: list[list[bool]] = []

    def run(_: object, places: list[Place], whole: list[Place]) -> list[Windows]:
        asked.append([one in whole for one in places])
        return [Windows(np.float32([step]), np.float32([-step]), 3) for _, step in places]

    monkeypatch.setattr(kept_windows, "_run", run)
    monkeypatch.setattr(kept_windows, "made_of", lambda _, folder, step: {"step": step})
    config = {"detector": "same", "schedule": {"batch_size": 1}}
    spec = SimpleNamespace(stage=SimpleNamespace(config=config))
    monkeypatch.setattr(kept_windows, "read_spec", lambda _: spec)
    sweep: Any = None
    folder = RunFolder(tmp_path / "stages" / "key")
    first, second = (folder, 8), (folder, 16)
    both = [first, second]
    assert missing_windows(sweep, [*both, first], [second]) == [both]
    make_windows(sweep, both, [second])
    assert not missing_windows(sweep, both, [second])
    assert missing_windows(sweep, both, both) == [[first]]
    assert sorted(path.name for path in (folder.path / "kept").iterdir()) == [
        "00000008-positives.bin",
        "00000016-positives.bin",
        "00000016-windows.bin",
    ]
    assert positives_of(sweep, *first).tolist() == [8.0]
    assert windows_of(sweep, *second).negative.tolist() == [-16.0]
    assert asked == [[False, True]]
    assert windows_of(sweep, *first).negative.tolist() == [-8.0]
    assert asked[1:] == [[True]]


def test_positives_are_kept_by_themselves_and_made_again_of_other_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[str] = []
    weights = ["a"]
    negative = np.zeros(5, np.float32)

    def run(*_: object) -> list[Windows]:
        runs.append(weights[0])
        positive = np.array([1.5, 2.5], np.float32) * (1 if weights == ["a"] else 2)
        return [Windows(positive, negative, 3)]

    monkeypatch.setattr(kept_windows, "_run", run)
    monkeypatch.setattr(kept_windows, "made_of", lambda *_: {"weights": weights[0]})
    sweep: Any = None
    folder = RunFolder(tmp_path / "stages" / "key")
    for _ in range(2):
        assert positives_of(sweep, folder, 8).tolist() == [1.5, 2.5]
    assert runs == ["a"]
    weights[0] = "b"
    assert positives_of(sweep, folder, 8).tolist() == [3.0, 5.0]
    assert runs == ["a", "b"]
    assert not folder.kept(8, "windows").exists()
    assert windows_of(sweep, folder, 8).negative.tolist() == [0.0] * 5
    folder.kept(8, "positives").unlink()  # of kept windows they are read
    assert positives_of(sweep, folder, 8).tolist() == [3.0, 5.0]
    assert runs == ["a", "b", "b"]


def test_who_carries_the_loss_is_kept_as_it_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    own = Windows(*(rng.normal(size=(2, 40)).astype(np.float32)), 3)
    asked: list[int] = []

    def found(*_: object) -> Windows:
        asked.append(1)
        return own

    monkeypatch.setattr(claims, "windows_of", found)
    monkeypatch.setattr(claims, "made_of", lambda *_: {"weights": "a"})
    sweep: Any = None
    folder = RunFolder(tmp_path / "stages" / "key")
    first, again = (claims._carried_by(sweep, folder, 8) for _ in range(2))
    assert first == again == carried(own.positive, own.negative)
    assert asked == [1]


@pytest.mark.parametrize("name", ["voxelnet", "fcn3d"])
def test_a_stage_keeps_the_positives_of_its_last_checkpoint_which_a_report_then_reads(
    name: str, simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, stages = train(simulated, tmp_path, [f"detector={name}", "loss.gamma=2"])
    folder = RunFolder(stages / plan.trials[0].stages[-1])
    spec, step = read_spec(folder), folder.steps()[-1]
    frames = Frames(spec.kitti(), spec.machine.val_ids, 0)
    (made,) = collect_windows([load(folder, step)], frames, batch_size=spec.settings.batch_size)
    monkeypatch.setattr(kept_windows, "_run", None)  # a report need not
    sweep: Any = SimpleNamespace(frames_digest=input_digest(spec.kitti(), frames.ids))
    assert not missing_windows(sweep, [(folder, step)], [])
    np.testing.assert_array_equal(positives_of(sweep, folder, step), made.positive)
    assert len(made.positive) > 0
