"""The learning rate's cycle beside torch's own, and stages that add parts to a network."""

from pathlib import Path

import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.runs.checkpoints import load_state
from fl3d.runs.spec import read_scores
from fl3d.sweep.setup import Prepared, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training.rates import OneCycle, StepDecay
from tests.support import train_stages

CYCLE = OneCycle(0.1, 0.4, 1e-5, (0.95, 0.85))


def test_it_is_torchs_cycle() -> None:
    """OneCycleLR counts its rise to the step before; where it lands on a step both are the same."""
    steps = 101
    rise = 0.4
    optimizer = torch.optim.AdamW([torch.nn.Parameter(torch.zeros(1))], lr=1.0, betas=(0.95, 0.99))
    theirs = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        0.002,
        total_steps=steps,
        pct_start=(rise * (steps - 1) + 1) / steps,
        div_factor=10,
        final_div_factor=1e4,
        base_momentum=0.85,
        max_momentum=0.95,
    )
    for step in range(steps):
        group = optimizer.param_groups[0]
        own = {"betas": (0.0, 0.99)}
        CYCLE.set_momentum(own, step / (steps - 1))
        assert 0.002 * CYCLE.factor(step / (steps - 1)) == pytest.approx(group["lr"], rel=1e-6)
        assert own["betas"] == pytest.approx(group["betas"])
        optimizer.step()
        if step < steps - 1:
            theirs.step()


def test_momentum_of_sgd_and_of_none() -> None:
    sgd = {"momentum": 0.0}
    none = {"lr": 1.0}
    CYCLE.set_momentum(sgd, 0.4)
    CYCLE.set_momentum(none, 0.4)
    assert sgd["momentum"] == pytest.approx(0.85)
    assert none == {"lr": 1.0}


@pytest.mark.parametrize(
    ("rise", "momentum"), [(0.0, (0.9, 0.8)), (1.0, (0.9, 0.8)), (0.5, (1.0, 0.8))]
)
def test_what_is_no_cycle_is_refused(rise: float, momentum: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match=r"schedule.one_cycle"):
        OneCycle(0.1, rise, 1e-5, momentum)


def test_decay_in_steps_as_the_report_trains_its_second_detector() -> None:
    """Times 0.1 every 20 of 50 epochs, never below a hundredth (1e-5 of 1e-3)."""
    decay = StepDecay(20, 0.1, 0.01)
    factors = [decay.of(epoch) for epoch in (0, 19, 20, 39, 40, 60)]
    assert factors == pytest.approx([1, 1, 0.1, 0.1, 0.01, 0.01])
    with pytest.raises(ConfigError, match=r"schedule.decay: every 0 epochs"):
        StepDecay(0, 0.1, 0.01)


def two_stage_sweep(simulated: Path, root: Path, *overrides: str) -> Prepared:
    shared = [
        f"data.root={simulated}",
        f"store.root={root / 'runs'}",
        "profile=tiny",
        "detector=pointrcnn",
        "data.generate=false",
        "schedule.frames_per_epoch=4",
        "schedule.epochs.rpn=2",
        "schedule.epochs.rcnn=2",
        "schedule.batch_size=2",
        "schedule.stages.rpn.set.schedule.batch_size=2",
    ]
    config = compose_config([*shared, *overrides])
    return prepare_sweep(Listed([point_of(overrides, config)]))


@pytest.fixture(scope="module")
def trained(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    sweep = two_stage_sweep(simulated, tmp_path_factory.mktemp("two"))
    train_stages(sweep)
    return sweep


def weights(sweep: Prepared, key: str) -> dict:
    folder = sweep.layout.run(key)
    return load_state(folder.weights(folder.steps()[-1]))


def test_the_second_stage_keeps_the_first_to_the_bit_and_trains_its_own(trained: Prepared) -> None:
    rpn, rcnn = (weights(trained, key) for key in trained.plan.trials[0].stages)
    assert not any(name.startswith("rcnn.") for name in rpn["model"])
    assert all(torch.equal(value, rcnn["model"][name]) for name, value in rpn["model"].items())
    own = [name for name in rcnn["model"] if name.startswith("rcnn.")]
    assert own
    assert len(rcnn["optimizer"]["state"]) == len(own)  # no moments of what is frozen


def test_a_first_stage_is_shared_whatever_the_second_is(
    trained: Prepared, simulated: Path, tmp_path: Path
) -> None:
    other = two_stage_sweep(simulated, tmp_path, "detector.rcnn.bin=0.3")
    assert other.plan.trials[0].stages[0] == trained.plan.trials[0].stages[0]
    assert other.plan.trials[0].key != trained.plan.trials[0].key
    alone = two_stage_sweep(simulated, tmp_path, "schedule.stages.rcnn=null")
    assert [stage.name for stage in alone.plan.stages.values()] == ["rpn"]
    assert alone.plan.trials[0].key == trained.plan.trials[0].stages[0]


def test_trained_again_it_is_the_same_to_the_bit(
    trained: Prepared, simulated: Path, tmp_path: Path
) -> None:
    """Augmentation, regions drawn at random and the cycle included."""
    again = two_stage_sweep(simulated, tmp_path)
    train_stages(again)
    key = trained.plan.trials[0].key
    first = weights(trained, key)["model"]
    second = weights(again, key)["model"]
    assert all(torch.equal(value, second[name]) for name, value in first.items())


def test_its_scores_hold_the_recall_of_all_boxes(trained: Prepared) -> None:
    for key in trained.plan.trials[0].stages:
        folder = trained.layout.run(key)
        scores = read_scores(folder, folder.steps()[-1], trained.settings.protocol.id)
        assert scores is not None
        shares = [scores[f"recall_3d/{t}"] for t in ("0.1", "0.3", "0.5", "0.7", "0.9")]
        assert all(0 <= share <= 1 for share in shares)
        assert shares == sorted(shares, reverse=True)


def test_a_second_stage_alone_is_refused(simulated: Path, tmp_path: Path) -> None:
    message = r"'rcnn' comes first, but nothing would have trained its rpn"
    with pytest.raises(ConfigError, match=message):
        two_stage_sweep(simulated, tmp_path, "schedule.stages.rpn=null")


def test_augmentation_that_a_detector_would_misread_is_refused(
    simulated: Path, tmp_path: Path
) -> None:
    shared = [
        "profile=tiny",
        "data.generate=false",
        f"data.root={simulated}",
        f"store.root={tmp_path}",
    ]
    change = "augment={_target_:fl3d.data.augment.Augmentation,flip:1.0,turn:0.0,scale:0.0}"
    config = compose_config([*shared, "detector=fconvnet", change])
    with pytest.raises(ConfigError, match=r"augment: F-ConvNet has its own"):
        prepare_sweep(Listed([point_of((), config)]))
    config = compose_config([*shared, "detector=voxelnet", change])
    prepare_sweep(Listed([point_of((), config)]))
