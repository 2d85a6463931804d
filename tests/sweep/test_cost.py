"""What a plan costs, and how it is shown: by hand arithmetic."""

from pathlib import Path

import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.core.records import Checkpoint, Stage
from fl3d.detectors.flops import layer_flops
from fl3d.inference.load import build_detector
from fl3d.runs.checkpoints import write_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.retention import kept_epochs
from fl3d.runs.spec import Machine, Spec, write_spec
from fl3d.sweep.cost import Costs, checkpoint_epochs
from fl3d.sweep.makespan import makespan
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.sweepers.grid import point_of
from fl3d.sweep.tree import plan_tree


def stage(key: str, parent: str | None) -> Stage:
    return Stage(
        key=key,
        name=key,
        config={"detector": {"_target_": "D"}, "loss": {}},
        parent=parent,
        start_epoch=0,
        start_step=0,
        epochs=1,
        epoch_steps=1,
    )


def tree(*stages: Stage) -> Plan:
    return Plan("test", (), {one.key: one for one in stages})


def planned(*points: list[str]) -> Plan:
    """A plan of quick trials, each of some overrides."""
    laid_out = [point_of(point, compose_config(["profile=quick", *point])) for point in points]
    base = laid_out[0].config
    swept = list(laid_out[0].values)
    return Planner(base, read_settings(base), swept, DataInfo("digest", 400)).plan(laid_out)


def test_the_makespan_of_two_slots_by_hand() -> None:
    """a (4 s) then a1, a2 (2 s each), beside b (5 s) then b1 (1 s).

    a and b start at 0, a1 at 4, a2 at 5, b1 at 6.
    """
    plan = tree(
        stage("a", None), stage("a1", "a"), stage("a2", "a"), stage("b", None), stage("b1", "b")
    )
    seconds = {"a": 4.0, "a1": 2.0, "a2": 2.0, "b": 5.0, "b1": 1.0}
    assert makespan(plan, seconds, 2) == pytest.approx(7.0)
    assert makespan(plan, seconds, 1) == pytest.approx(14.0)
    assert makespan(plan, seconds, 9) == pytest.approx(6.0)
    assert makespan(plan, {"a1": 2.0, "b1": 1.0}, 2) == pytest.approx(2.0)  # parents are done
    assert makespan(plan, {}, 2) == 0


def test_flops_and_bytes_by_hand(tmp_path: Path) -> None:
    """Quick VoxelNet, 3 epochs of 400 frames forward and backward, 300 validation frames thrice."""
    plan = planned(["detector=voxelnet", "schedule.epochs.warmup=3"])
    warmup = next(iter(plan.stages.values()))
    cost = Costs(tmp_path, 300).cost(warmup)
    frame = sum(layer_flops(lambda: build_detector(warmup.config)).values())
    assert cost.flops == frame * (3 * 400 * 3 + 3 * 300)
    with torch.device("meta"):
        weights = sum(p.numel() for p in build_detector(warmup.config).parameters())
    assert cost.weights_bytes == pytest.approx(
        3 * 3 * 4 * weights, rel=0.02
    )  # Adam keeps two moments
    assert not cost.is_measured
    assert cost.seconds > 0


class Counting(torch.optim.SGD):
    """Keeps a count of steps in a tensor of its own and reads it, as Adam of torch 2.11 does."""

    def step(self, closure: object = None) -> None:  # type: ignore[override]
        for group in self.param_groups:
            for parameter in group["params"]:
                count = self.state[parameter].setdefault("step", torch.tensor(0.0))
                self.state[parameter]["step"] = torch.tensor(count.item() + 1)


def test_an_optimiser_may_read_its_state(tmp_path: Path) -> None:
    """Weights, and four bytes of each one's count."""
    target = f"optimizer._target_={Counting.__module__}.Counting"
    warmup = next(iter(planned(["detector=fcn3d", target]).stages.values()))
    with torch.device("meta"):
        detector = build_detector(warmup.config)
    values = sum(v.numel() * v.element_size() for v in detector.state_dict().values())
    kept = values + 4 * len(list(detector.parameters()))
    assert Costs(tmp_path, 300).cost(warmup).weights_bytes == kept * len(checkpoint_epochs(warmup))


def test_a_second_network_is_guessed_by_how_slow_the_first_was(tmp_path: Path) -> None:
    """PointRCNN's steps are mostly no layers' work: having seen one stage, the guess knows that."""
    plan = planned(["detector=pointrcnn"])
    rpn, rcnn = plan.stages.values()
    costs = Costs(tmp_path, 300)
    before = [costs.cost(one).seconds for one in (rpn, rcnn)]
    folder = RunFolder(tmp_path / rpn.key)
    machine = Machine(
        data_root=tmp_path,
        train_ids=(),
        val_ids=("000000",) * 300,
        protocol=read_settings(plan.trials[0].config).protocol,
    )
    write_spec(folder, Spec(rpn, machine))
    every = rpn.config["schedule"]["checkpoint_every"]
    steps = rpn.epoch_steps * every
    frame = sum(layer_flops(lambda: build_detector(rpn.config)).values())
    flops = frame * rpn.config["schedule"]["batch_size"] * 3
    training = 40 * steps * flops / costs.speed()  # 40 times as long as the FLOPs say
    seconds = {"training": training, "detection": 3.0, "scoring": 0.0}
    write_marker(
        folder,
        Checkpoint(
            stage=rpn.key,
            step=steps,
            epoch=every,
            lr=1e-3,
            losses={},
            seconds=seconds,
            sha256="",
            detections_sha256="",
        ),
    )
    fresh = Costs(tmp_path, 300)  # asked for the second alone, as a resumed sweep does
    fresh.learn()
    assert fresh.cost(rcnn).seconds == pytest.approx(40 * before[1])
    costs.learn()
    known = costs.cost(rpn)
    guessed = costs.cost(rcnn)
    assert known.is_measured
    assert not guessed.is_measured
    assert guessed.seconds == pytest.approx(40 * before[1])
    looks = len(checkpoint_epochs(rpn))
    assert known.seconds == pytest.approx(rpn.steps * 40 * flops / costs.speed() + looks * 3.0)


def test_stages_have_a_checkpoint_each_so_many_epochs_and_at_the_end() -> None:
    plan = planned(["detector=voxelnet", "schedule.epochs.warmup=3", "schedule.checkpoint_every=2"])
    assert [checkpoint_epochs(one) for one in plan.stages.values()] == [[2, 3], [2]]


def test_what_is_kept_is_the_last_the_best_and_each_kth() -> None:
    means = {1: 10.0, 2: 30.0, 3: 30.0, 4: 20.0, 5: 5.0, 6: 7.0, 7: 6.0}
    assert kept_epochs(list(means), [means], [None]) == {2, 7}  # the earlier of two that tie
    assert kept_epochs(list(means), [means], [3, None]) == {2, 3, 6, 7}
    other = {epoch: -mean for epoch, mean in means.items()}
    assert kept_epochs(list(means), [means, other], [None]) == {
        2,
        5,
        7,
    }  # the best under each protocol
    assert kept_epochs([1], [{1: 0.0}], [None]) == {1}


def test_a_tree_tells_what_sets_stages_apart() -> None:
    plan = planned(
        *([f"seed={seed}", f"loss.gamma={gamma}"] for seed in (0, 1) for gamma in (0, 2))
    )
    lines = plan_tree(plan, lambda one: f"{one.epochs} epochs")
    assert lines == [
        "VoxelNet warmup seed=0 (shared): 12 epochs",
        "├─ focal loss.gamma=0: 2 epochs",
        "└─ focal loss.gamma=2: 2 epochs",
        "VoxelNet warmup seed=1 (shared): 12 epochs",
        "├─ focal loss.gamma=0: 2 epochs",
        "└─ focal loss.gamma=2: 2 epochs",
    ]


def test_a_second_stages_alpha_is_searched_under_one_first_stage() -> None:
    plan = planned(*([f"+schedule.stages.focal.set.loss.alpha={a}"] for a in (0.5, 1, 2)))
    assert len(plan.stages) == 1 + 3
    assert [one.config["loss"]["alpha"] for one in plan.stages.values()] == [1.0, 0.5, 1, 2]
