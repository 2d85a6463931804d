"""Train one stage: epochs, checkpoints, detections and scores."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import torch
from torch import nn
from torch.utils.data import DataLoader, Dataset

from fl3d.core.errors import CheckpointError, TrainingError
from fl3d.core.records import Stage
from fl3d.data.augment import Augmentation
from fl3d.data.dataset import Frames, epoch_order
from fl3d.detectors.base import Batch, Detector, Sample
from fl3d.inference.detect import to_device
from fl3d.inference.precision import multiplying
from fl3d.inference.reproducibility import random_state, sample_generator, set_random_state
from fl3d.runs.checkpoints import State
from fl3d.training.rates import OneCycle, StepDecay

VERSION = 1  # raised whenever the same stage would train to other bits


@dataclass(frozen=True)
class Schedule:
    """How a stage is trained.

    Args:
        batch_size: frames in a step.
        frames_per_epoch: frames in an epoch, the split repeated or cut as needed; None: each frame once.
        lr_factor: of this stage on the optimiser's learning rate.
        clip: largest norm of the gradient; None: no limit.
        ramp_steps: the learning rate rises linearly over the first steps of the first stage.
        checkpoint_every: epochs between checkpoints; the last epoch always has one.
        save_every_steps: steps between resume points within an epoch; None: none.
        one_cycle: how the learning rate rises and falls over the stage; None: it does not.
        decay: how it falls in steps; None: it does not.
    """

    batch_size: int
    frames_per_epoch: int | None
    lr_factor: float
    clip: float | None
    ramp_steps: int
    checkpoint_every: int
    save_every_steps: int | None = None
    one_cycle: OneCycle | None = None
    decay: StepDecay | None = None

    def epoch_frames(self, n_frames: int) -> int:
        """Frames in one epoch."""
        return self.frames_per_epoch or n_frames


Draw = tuple[int, int, int]  # of a sample: epoch, position in it, frame


class _Samples(Dataset[Sample]):
    """Encoded frames, by epoch, position in it and frame; randomness comes from the first two."""

    def __init__(
        self, detector: Detector, frames: Frames, seed: int, augment: Augmentation | None
    ) -> None:
        self.detector, self.frames, self.seed, self.augment = detector, frames, seed, augment

    def __getitem__(self, draw: Draw) -> Sample:
        epoch, position, index = draw
        rng = sample_generator(self.seed, epoch, position)
        frame = (
            self.frames[index] if self.augment is None else self.augment(self.frames, index, rng)
        )
        return self.detector.encode(frame, rng, training=True)


@dataclass
class Averages:
    """Running means of loss terms."""

    sums: dict[str, float] = field(default_factory=dict)
    count: int = 0

    def add(self, terms: dict[str, float]) -> None:
        """Add one step's terms."""
        for name, value in terms.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.count += 1

    def means(self) -> dict[str, float]:
        """Mean of each term since the start."""
        return {name: value / self.count for name, value in self.sums.items()}


class Trainer:
    """A detector in training.

    Args:
        stage: what is trained.
        detector: the network, on its device.
        optimizer: over its parameters.
        schedule: of the stage.
        frames: training frames.
        device: torch's name of it.
        workers: loader processes; 0 loads in this one. The number does not change a bit.
        augment: changes training frames at random; None: they are as they are.
    """

    def __init__(
        self,
        stage: Stage,
        detector: Detector,
        optimizer: torch.optim.Optimizer,
        schedule: Schedule,
        frames: Frames,
        device: str = "cpu",
        workers: int = 0,
        augment: Augmentation | None = None,
    ) -> None:
        self.stage, self.detector, self.optimizer, self.schedule = (
            stage,
            detector,
            optimizer,
            schedule,
        )
        self.frames, self.device, self.workers, self.augment = frames, device, workers, augment
        self.seed: int = stage.config["seed"]
        self.precision: str = stage.config["precision"]
        self.base_lr: float = optimizer.param_groups[0]["lr"] * schedule.lr_factor
        self.step = stage.start_step
        self.averages = Averages()
        self.waited = 0.0  # seconds that steps waited for their batch
        self._stream: Iterator[Batch] | None = None

    def state(self) -> State:
        """Everything that training depends on from here."""
        return {
            "model": self.detector.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "random": random_state(self.device),
            "step": self.step,
            "averages": {"sums": dict(self.averages.sums), "count": self.averages.count},
        }

    def restore(self, state: State, is_parents: bool = False) -> None:
        """Go on from a state.

        Args:
            state: of this stage or of its parent.
            is_parents: a network that has parts its parent had not keeps those as they are, and its optimiser anew.

        Raises:
            CheckpointError: it is of another network.
        """
        own = [
            {k: v for k, v in g.items() if k not in ("params", "lr")}
            for g in self.optimizer.param_groups
        ]
        new = (
            [key for key in self.detector.state_dict() if key not in state["model"]]
            if is_parents
            else []
        )
        try:
            self.detector.load_state_dict(
                state["model"] | {key: self.detector.state_dict()[key] for key in new}
            )
            if not new:
                self.optimizer.load_state_dict(state["optimizer"])
        except (RuntimeError, ValueError, KeyError) as error:
            raise CheckpointError(
                f"{self.stage.key}: the checkpoint is of another network: {error}"
            ) from None
        for group, values in zip(self.optimizer.param_groups, own, strict=True):
            group.update(
                values
            )  # moments come from the checkpoint, settings from this stage's config
        set_random_state(state["random"], self.device)
        self.step = state["step"]
        self.averages = Averages(**state["averages"])
        self._stream = None

    def lr(self) -> float:
        """Learning rate of the next step."""
        ramp, cycle, decay = self.schedule.ramp_steps, self.schedule.one_cycle, self.schedule.decay
        lr = self.base_lr * (cycle.factor(self._progress()) if cycle else 1.0)
        lr *= decay.of(self._place()[0]) if decay else 1.0
        return lr * min(1.0, (self.step + 1) / ramp) if ramp else lr

    def _progress(self) -> float:
        """Share of the stage that is behind the next step."""
        return min(1.0, (self.step - self.stage.start_step) / max(1, self.stage.steps - 1))

    @property
    def epoch(self) -> int:
        """Epochs completed, over all stages."""
        return self.stage.start_epoch + self._place()[0]

    def _place(self) -> tuple[int, int]:
        """Own epochs completed, and steps into the next."""
        return divmod(self.step - self.stage.start_step, self.stage.epoch_steps)

    def train_epoch(self, after_step: Callable[[], None]) -> None:
        """Train to the end of the current epoch, from wherever in it the state stands."""
        self.detector.train()
        self._stream = self._stream or iter(self._loader())
        for _ in range(self.stage.epoch_steps - self._place()[1]):
            started = time.perf_counter()
            batch = to_device(next(self._stream), self.device)
            self.waited += time.perf_counter() - started
            self._step(batch)
            after_step()

    def _loader(self) -> DataLoader[Sample]:
        """Batches from here to the end of the stage: its processes live as long, and work ahead."""
        return DataLoader(
            _Samples(self.detector, self.frames, self.seed, self.augment),
            batch_sampler=list(self._draws()),
            collate_fn=self.detector.collate,
            num_workers=self.workers,
            generator=torch.Generator(),  # its own, so that making a loader does not advance the global one
        )

    def _draws(self) -> Iterator[list[Draw]]:
        n_frames, size = self.schedule.epoch_frames(len(self.frames)), self.schedule.batch_size
        passes = math.ceil(n_frames / len(self.frames))
        skip = self._place()[1]
        for epoch in range(self.epoch, self.stage.start_epoch + self.stage.epochs):
            order = epoch_order(len(self.frames), passes, self.seed, epoch)[:n_frames]
            draws = [(epoch, position, int(frame)) for position, frame in enumerate(order)]
            yield from (draws[i : i + size] for i in range(skip * size, n_frames, size))
            skip = 0

    def _step(self, batch: Batch) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self.lr()
            if self.schedule.one_cycle is not None:
                self.schedule.one_cycle.set_momentum(group, self._progress())
        with multiplying(self.precision, self.device):
            terms = self.detector.loss(batch)
        if not terms:
            self.step += 1
            return
        total = torch.stack(list(terms.values())).sum()
        if not torch.isfinite(total):
            values = {name: float(value.detach()) for name, value in terms.items()}
            raise TrainingError(
                f"{self.stage.key}: the loss is not finite at step {self.step + 1}: {values}"
            )
        self.optimizer.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        if self.schedule.clip is not None:
            nn.utils.clip_grad_norm_(self.detector.parameters(), self.schedule.clip)
        self.optimizer.step()
        self.step += 1
        self.averages.add(
            {"total": float(total.detach())} | {k: float(v.detach()) for k, v in terms.items()}
        )
