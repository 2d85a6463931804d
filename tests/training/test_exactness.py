"""Forked equals from scratch, resumed equals uninterrupted: to the bit."""

import errno
import io
import os
from pathlib import Path

import pytest
import torch

from fl3d.core.errors import CheckpointError, TrainingError
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.voxelnet import VoxelNet
from fl3d.inference.detect import detect_frames
from fl3d.inference.load import build_detector
from fl3d.inference.reproducibility import prepare
from fl3d.runs.checkpoints import last_state, load_state, read_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec
from fl3d.sparse import layers
from fl3d.training.build import build_optimizer, build_schedule
from fl3d.training.stage import run_stage
from fl3d.training.trainer import Trainer
from tests.support import last_weights, small_sweep, train, train_stages

GAMMA_2 = ["detector=voxelnet", "loss.gamma=2"]


def same_state(a: object, b: object) -> bool:
    """Equal tensors and values, however nested; torch.save's bytes differ in storage order."""
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and torch.equal(a, b)
    if isinstance(a, dict):
        if not isinstance(b, dict) or a.keys() != b.keys():
            return False
        return all(same_state(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        if not isinstance(b, list | tuple) or len(a) != len(b):
            return False
        return all(same_state(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def final_state(stages: Path, key: str) -> dict:
    folder = RunFolder(stages / key)
    return load_state(folder.weights(folder.steps()[-1]))


@pytest.mark.parametrize("detector", ["fcn3d", "voxelnet"])
def test_a_forked_trial_equals_one_trained_from_scratch_without_stopping(
    simulated: Path, tmp_path: Path, detector: str
) -> None:
    """The scratch side never writes a checkpoint: one network, learning rate and loss swapped."""
    points = [[f"detector={detector}", f"loss.gamma={g}"] for g in (0, 2)]
    plan, stages = train(simulated, tmp_path, *points)
    trial = plan.trials[1]
    warmup, focal = (plan.stages[key] for key in trial.stages)
    assert plan.trials[0].stages[0] == warmup.key
    forked = final_state(stages, focal.key)

    train_ids = read_spec(RunFolder(stages / focal.key)).machine.train_ids
    prepare(0, "cpu")
    frames = Frames(KittiFolder(simulated), train_ids, 10)
    network = build_detector(warmup.config)
    optimizer = build_optimizer(warmup.config, network)
    first = Trainer(warmup, network, optimizer, build_schedule(warmup.config), frames)
    for _ in range(warmup.epochs):
        first.train_epoch(lambda: None)
    optimizer.param_groups[0]["lr"] = warmup.config["optimizer"]["lr"]
    network.detection_loss = build_detector(focal.config).detection_loss
    torch.set_rng_state(forked["random"]["cpu"])  # the network that was built drew its weights
    second = Trainer(focal, network, optimizer, build_schedule(focal.config), frames)
    for _ in range(focal.epochs):
        second.train_epoch(lambda: None)
    assert same_state(second.state()["model"], forked["model"])
    assert same_state(second.state()["optimizer"], forked["optimizer"])


def test_alone_or_among_others_a_trial_trains_to_the_same_bits(
    simulated: Path, tmp_path: Path
) -> None:
    points = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]
    among, root_a = train(simulated, tmp_path / "a", *points)
    alone, root_b = train(simulated, tmp_path / "b", GAMMA_2)
    key = alone.trials[0].key
    assert key == among.trials[1].key
    assert same_state(final_state(root_a, key), final_state(root_b, key))


class Stopped(BaseException):
    """Stands for a kill: nothing catches it."""


@pytest.mark.parametrize("stop_at", [1, 2, 3])
@pytest.mark.parametrize("save_every", ["null", "1"])
def test_a_resumed_stage_equals_an_uninterrupted_one(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop_at: int, save_every: str
) -> None:
    """Stopped after any step, within an epoch or between, with and without resume points."""
    _, whole_root = train(simulated, tmp_path / "whole", GAMMA_2)
    point = [*GAMMA_2, f"schedule.save_every_steps={save_every}"]
    sweep = small_sweep(simulated, tmp_path / "cut", [point])
    original = Trainer._step
    steps = iter(range(100))

    def step(self: Trainer, batch: dict) -> None:
        if next(steps) == stop_at:
            raise Stopped
        original(self, batch)

    monkeypatch.setattr(Trainer, "_step", step)
    with pytest.raises(Stopped):
        train_stages(sweep)
    monkeypatch.setattr(Trainer, "_step", original)
    train_stages(sweep)
    key = sweep.plan.trials[0].key
    whole = RunFolder(whole_root / key)
    cut = sweep.layout.run(key)
    assert same_state(final_state(whole_root, key), final_state(sweep.layout.stages, key))
    assert whole.steps() == cut.steps()
    for number in whole.steps():
        assert read_marker(whole, number).losses == read_marker(cut, number).losses


def test_resumed_on_sparse_maps_it_is_as_if_never_stopped(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layers, "DENSE_FROM", float("inf"))
    seen: list[bool] = []
    collate = VoxelNet.collate

    def noting(self: VoxelNet, samples: list) -> dict:
        batch = collate(self, samples)
        seen.append("layout" in batch)
        return batch

    monkeypatch.setattr(VoxelNet, "collate", noting)
    plan, whole_root = train(simulated, tmp_path / "whole", GAMMA_2)
    key = plan.trials[0].key
    passes = iter(range(100))

    def detect(*arguments: object, **options: object) -> object:
        if next(passes) == 2:
            raise Stopped
        return detect_frames(*arguments, **options)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr("fl3d.training.stage.detect_frames", detect)
        with pytest.raises(Stopped):
            train(simulated, tmp_path / "cut", GAMMA_2)
    _, cut_root = train(simulated, tmp_path / "cut", GAMMA_2)
    assert same_state(final_state(whole_root, key), final_state(cut_root, key))
    assert seen
    assert all(seen)


@pytest.mark.parametrize(
    "save_every", ["null", "2"]
)  # 2 steps are one epoch: a resume point at its very end
@pytest.mark.parametrize("stop_at", [0, 1, 2, 3])
def test_stopped_while_detecting_no_checkpoint_is_lost(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop_at: int, save_every: str
) -> None:
    """The way from an epoch's last step to its checkpoint is long: the stop comes within it."""
    point = [*GAMMA_2, f"schedule.save_every_steps={save_every}"]
    plan, whole_root = train(simulated, tmp_path / "whole", point)
    passes = iter(range(100))

    def detect(*arguments: object, **options: object) -> object:
        if next(passes) == stop_at:
            raise Stopped
        return detect_frames(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("fl3d.training.stage.detect_frames", detect)
    with pytest.raises(Stopped):
        train(simulated, tmp_path / "cut", point)
    _, cut_root = train(simulated, tmp_path / "cut", point)
    for key in plan.stages:
        assert RunFolder(cut_root / key).steps() == RunFolder(whole_root / key).steps()
        assert same_state(final_state(whole_root, key), final_state(cut_root, key))


def test_a_stages_own_optimizer_settings_hold_after_the_fork(
    simulated: Path, tmp_path: Path
) -> None:
    """Moments come from the parent's checkpoint, settings from the stage's config."""
    plain, root = train(simulated, tmp_path / "a", GAMMA_2)
    decayed = [
        "+optimizer.weight_decay=0.0",
        "+schedule.stages.focal.set.optimizer.weight_decay=0.5",
    ]
    plan, other_root = train(simulated, tmp_path / "b", [*GAMMA_2, *decayed])
    state = final_state(other_root, plan.trials[0].key)
    assert state["optimizer"]["param_groups"][0]["weight_decay"] == 0.5
    assert not same_state(state["model"], final_state(root, plain.trials[0].key)["model"])


# inf: maps stay sparse in this small network too.
@pytest.mark.parametrize("dense_from", [layers.DENSE_FROM, float("inf")])
def test_loader_workers_do_not_change_a_bit(
    dense_from: float, simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Loader processes are forked, and know it.
    monkeypatch.setattr(layers, "DENSE_FROM", dense_from)
    _, alone = train(simulated, tmp_path / "a", GAMMA_2)
    plan, helped = train(simulated, tmp_path / "b", [*GAMMA_2, "workers=2"])
    key = plan.trials[0].key
    assert same_state(final_state(alone, key), final_state(helped, key))


def test_a_torn_checkpoint_is_passed_over_for_the_one_before(
    simulated: Path, tmp_path: Path
) -> None:
    plan, root = train(simulated, tmp_path, GAMMA_2)
    key = plan.trials[0].key
    whole = final_state(root, key)
    folder = RunFolder(root / key)
    first, last = folder.steps()
    weights = folder.weights(last)
    weights.write_bytes(weights.read_bytes()[:-100])
    found = last_state(folder)
    assert found is not None
    assert found[1].step == first
    folder.done.unlink()
    run_stage(folder.path)
    assert same_state(final_state(root, key), whole)


def test_a_torn_marker_is_passed_over_and_made_anew(simulated: Path, tmp_path: Path) -> None:
    plan, root = train(simulated, tmp_path, GAMMA_2)
    key = plan.trials[0].key
    whole = final_state(root, key)
    folder = RunFolder(root / key)
    _, last = folder.steps()
    folder.marker(last).write_text("{")
    folder.done.unlink()
    run_stage(folder.path)
    assert read_marker(folder, last).step == last
    assert same_state(final_state(root, key), whole)


@pytest.mark.parametrize(
    ("number", "begins"),
    [(errno.EIO, "OSError: [Errno 5]"), (errno.EINVAL, "Traceback")],
)
def test_a_disk_that_does_not_answer_is_said_without_a_traceback(
    number: int, begins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RunFolder(tmp_path)
    folder.spec.write_text("")

    def fails(_: object) -> None:
        raise OSError(number, os.strerror(number), "stage.json")

    monkeypatch.setattr("fl3d.training.stage.read_spec", fails)
    with pytest.raises(OSError, match=r"stage\.json"):
        run_stage(tmp_path)
    assert folder.error.read_text().startswith(begins)


def test_a_checkpoint_carries_no_code(simulated: Path, tmp_path: Path) -> None:
    plan, root = train(simulated, tmp_path, GAMMA_2)
    weights = io.BytesIO(last_weights(root, plan.trials[0].key))
    state = torch.load(weights, weights_only=True)
    assert {"model", "optimizer", "random", "step"} <= set(state)


def test_a_file_that_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(CheckpointError, match=r"x\.pt: cannot be read"):
        load_state(path)


def test_a_loss_that_is_not_finite_ends_the_stage_and_names_its_terms(
    simulated: Path, tmp_path: Path
) -> None:
    prepare(0, "cpu")
    sweep = small_sweep(simulated, tmp_path, [GAMMA_2])
    stage = sweep.plan.stages[sweep.plan.trials[0].stages[0]]
    network = build_detector(stage.config)
    torch.nn.init.constant_(network.rpn.prob.bias, float("nan"))
    frames = Frames(KittiFolder(simulated), sweep.data.train_ids, 10)
    optimizer = build_optimizer(stage.config, network)
    trainer = Trainer(stage, network, optimizer, build_schedule(stage.config), frames)
    with pytest.raises(TrainingError, match=r"not finite at step 1: .*cls_pos"):
        trainer.train_epoch(lambda: None)
