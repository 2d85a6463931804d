"""Steps of training by hand: the limit of the gradient's norm, and the learning rate."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from fl3d.core.records import Stage
from fl3d.data.kitti import Frame
from fl3d.detectors.base import Batch, Detector, Found, Sample
from fl3d.training.rates import OneCycle, StepDecay
from fl3d.training.trainer import Schedule, Trainer

SLOPES = torch.tensor([3.0, 4.0])
CYCLE = OneCycle(start=0.1, rise=0.5, end=0.01, momentum=(0.95, 0.85))
DECAY = StepDecay(every=2, factor=0.1, lowest=0.05)


class Slope(Detector):
    """Two weights, each a parameter of its own; the loss rises by 3 and by 4 with them."""

    NAME = "Slope"
    STAGES = ("only",)

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Parameter(torch.zeros(()))
        self.second = nn.Parameter(torch.zeros(()))

    def weights(self) -> list[float]:
        return [float(self.first.detach()), float(self.second.detach())]

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        return {}

    def collate(self, samples: list[Sample]) -> Batch:
        return {"slopes": SLOPES}

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        slopes = batch["slopes"]
        return {"first": self.first * slopes[0], "second": self.second * slopes[1]}

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        raise NotImplementedError

    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        raise NotImplementedError

    def example(self) -> Batch:
        return {"slopes": SLOPES}


def stage(epochs: int, epoch_steps: int, start_epoch: int = 0, start_step: int = 0) -> Stage:
    config = {"seed": 0, "precision": "float32"}
    parent = "before" if start_step else None
    return Stage(
        key="slope-only",
        name="only",
        config=config,
        parent=parent,
        start_epoch=start_epoch,
        start_step=start_step,
        epochs=epochs,
        epoch_steps=epoch_steps,
    )


def trainer_of(stage: Stage, lr: float = 1.0, momentum: float = 0.0, **changes: Any) -> Trainer:
    """Of a stage whose epoch is as many frames as steps."""
    detector = Slope()
    optimizer = torch.optim.SGD(detector.parameters(), lr=lr, momentum=momentum)
    settings: dict[str, Any] = {
        "batch_size": 1,
        "frames_per_epoch": None,
        "lr_factor": 1.0,
        "clip": None,
        "ramp_steps": 0,
        "checkpoint_every": 1,
    }
    frames: Any = [None] * stage.epoch_steps
    return Trainer(stage, detector, optimizer, Schedule(**settings | changes), frames)


def rates(trainer: Trainer, steps: list[int]) -> list[float]:
    """Learning rate of each of these steps, counted from the beginning of the first stage."""
    found = []
    for step in steps:
        trainer.step = step
        found.append(trainer.lr())
    return found


def moved(clip: float | None, n_steps: int = 1) -> list[float]:
    """Where the two weights are after some steps from zero at a learning rate of 0.1."""
    trainer = trainer_of(stage(epochs=1, epoch_steps=n_steps), lr=0.1, clip=clip)
    trainer.train_epoch(lambda: None)
    assert trainer.step == n_steps
    return trainer.detector.weights()  # type: ignore[operator]


@pytest.mark.parametrize(("clip", "share"), [(1.0, 1 / 5), (2.5, 1 / 2), (4.9, 4.9 / 5)])
def test_a_gradient_longer_than_the_limit_is_shortened_to_it(clip: float, share: float) -> None:
    """The gradient (3, 4) has norm 5 over both parameters; a step is -0.1 (3, 4) * limit / 5."""
    assert moved(clip) == pytest.approx([-0.3 * share, -0.4 * share], rel=1e-5)


@pytest.mark.parametrize("clip", [None, 5.1, 100.0])
def test_a_gradient_within_the_limit_or_without_one_stays_as_it_is(clip: float | None) -> None:
    assert moved(clip) == pytest.approx([-0.3, -0.4], rel=1e-6)


def test_every_step_is_limited_by_its_own_gradient_and_not_by_those_before() -> None:
    """Three steps of norm 0.1 * 1 in the direction (3, 4) / 5; and three of norm 5, below 7."""
    assert moved(1.0, n_steps=3) == pytest.approx([-0.18, -0.24], rel=1e-5)
    assert moved(7.0, n_steps=3) == pytest.approx([-0.9, -1.2], rel=1e-5)


def test_a_stages_factor_multiplies_the_optimisers_learning_rate() -> None:
    trainer = trainer_of(stage(1, 4), lr=0.5, lr_factor=0.1)
    assert rates(trainer, [0, 1, 3]) == pytest.approx([0.05, 0.05, 0.05])


def test_the_ramp_rises_by_equal_parts_from_one_part_to_the_whole() -> None:
    """Four steps: the first has a quarter and not nothing, the fourth has all."""
    trainer = trainer_of(stage(1, 8), lr=2.0, ramp_steps=4)
    assert rates(trainer, [0, 1, 2, 3, 4, 7]) == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.0, 2.0])


def test_the_ramp_is_of_the_whole_trial_and_a_later_stage_only_ends_it() -> None:
    """A stage from step 2 on has the third quarter and the fourth; one from step 4 on has all."""
    third = trainer_of(stage(2, 2, start_epoch=1, start_step=2), ramp_steps=4)
    assert rates(third, [2, 3, 4]) == pytest.approx([0.75, 1.0, 1.0])
    after = trainer_of(stage(2, 2, start_epoch=2, start_step=4), ramp_steps=4)
    assert rates(after, [4, 5]) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("start_step", [0, 20])
def test_the_cycle_runs_from_a_stages_first_step_to_its_last(start_step: int) -> None:
    """Five steps lie at 0, 1/4, 1/2, 3/4 and 1; half a cosine is halfway in its middle.

    From 0.1 over (0.1 + 1) / 2 = 0.55 up to 1, and over (1 + 0.01) / 2 = 0.505 down to 0.01. There
    it stays when the stage is over, for the last checkpoint to say. All of it times 2.
    """
    five = stage(1, 5, start_epoch=start_step // 5, start_step=start_step)
    trainer = trainer_of(five, lr=2.0, one_cycle=CYCLE)
    found = rates(trainer, [start_step + step for step in range(6)])
    assert found == pytest.approx([0.2, 1.1, 2.0, 1.01, 0.02, 0.02], rel=1e-12)


def test_the_cycle_spans_all_epochs_of_the_stage() -> None:
    """Three epochs of three steps: the middle is the fifth step and the end the ninth."""
    trainer = trainer_of(stage(3, 3, start_epoch=2, start_step=6), one_cycle=CYCLE)
    assert rates(trainer, [6, 10, 14]) == pytest.approx([0.1, 1.0, 0.01], rel=1e-12)


def test_the_cycle_of_a_single_step_is_its_beginning() -> None:
    trainer = trainer_of(stage(1, 1), one_cycle=CYCLE)
    assert rates(trainer, [0]) == pytest.approx([0.1])


@pytest.mark.parametrize(("start_epoch", "start_step"), [(0, 0), (3, 30)])
def test_decay_counts_the_epochs_of_the_stage_alone(start_epoch: int, start_step: int) -> None:
    """A tenth every two epochs of four steps: 0.1 after 8 steps, the floor of 0.05 after 16.

    By the epochs of the whole trial, a stage that starts after three would begin at a tenth.
    """
    trainer = trainer_of(stage(6, 4, start_epoch, start_step), lr=2.0, decay=DECAY)
    found = rates(trainer, [start_step + step for step in (0, 3, 4, 7, 8, 15, 16, 23)])
    assert found == pytest.approx([2.0, 2.0, 2.0, 2.0, 0.2, 0.2, 0.1, 0.1])


def test_factor_ramp_cycle_and_decay_multiply() -> None:
    """Three epochs of three steps from step 3 on, a ramp of ten, half every epoch; 2 * 0.5 = 1.

    Step 3: ramp 4/10, cycle 0.1, decay 1. Step 7, its fifth of nine: 8/10, 1 and 1/2. Step 11, its
    last: the ramp is over, 0.01 and 1/4.
    """
    trainer = trainer_of(
        stage(3, 3, start_epoch=1, start_step=3),
        lr=2.0,
        lr_factor=0.5,
        ramp_steps=10,
        one_cycle=CYCLE,
        decay=StepDecay(every=1, factor=0.5, lowest=0.0),
    )
    assert rates(trainer, [3, 7, 11]) == pytest.approx([0.04, 0.4, 0.0025], rel=1e-12)


def test_steps_are_made_at_the_learning_rate_and_momentum_of_their_place() -> None:
    """A ramp of two: half of the cycle's 0.1, then 0.55, 1, 0.505, 0.01; momentum against it."""
    trainer = trainer_of(stage(1, 5), momentum=0.5, ramp_steps=2, one_cycle=CYCLE)
    used: list[tuple[float, float]] = []

    def note() -> None:
        group = trainer.optimizer.param_groups[0]
        used.append((group["lr"], group["momentum"]))

    trainer.train_epoch(note)
    assert [lr for lr, _ in used] == pytest.approx([0.05, 0.55, 1.0, 0.505, 0.01], rel=1e-12)
    assert [momentum for _, momentum in used] == pytest.approx([0.95, 0.9, 0.85, 0.9, 0.95])
