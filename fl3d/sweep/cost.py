"""What a stage costs before it runs: time, floating point operations and disk; measured stages correct the guess."""

from __future__ import annotations

import contextlib
import statistics
import sys
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path

from fl3d.config.objects import locate
from fl3d.config.settings import read_stage_settings
from fl3d.core.digests import digest
from fl3d.core.errors import CheckpointError, ConfigError, StoreError
from fl3d.core.records import Config, Stage
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec
from fl3d.sweep.network_cost import BACKWARD, NetworkCost, measure_speed, network_cost
from fl3d.training.command import is_command

BOX_BYTES = 30  # of a stored detection, compressed; as measured
IMAGE_BOX_BYTES = 12  # of its own 2D box, likewise
PURPOSES = ("training", "detection", "scoring")


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a stage costs.

    Args:
        seconds: on one slot.
        flops: of training and of detection on the validation frames, by the network's dense layers.
        weights_bytes: of its checkpoints' weights and optimisers, as long as all are kept.
        detection_bytes: of what they predict on the validation frames, at most.
        is_known: whether there is a time at all: of a command none is guessed.
        is_measured: whether the time comes from stages of the same network, or from its FLOPs, and from how much longer
            than theirs the same detector's other networks took.
    """

    seconds: float
    flops: float
    weights_bytes: float
    detection_bytes: float
    is_measured: bool
    is_known: bool = True

    @property
    def bytes(self) -> float:
        """All that is written."""
        return self.weights_bytes + self.detection_bytes


@dataclass(frozen=True)
class _Rates:
    """What checkpoints of one kind took, seconds each.

    Args:
        steps: a training step.
        frames: looking at a validation frame.
    """

    steps: array[float] = field(default_factory=lambda: array("d"))
    frames: array[float] = field(default_factory=lambda: array("d"))


class Costs:
    """Costs of stages, by what is known so far.

    Args:
        stages_root: folder of all stages; those of the same network are what the time is learned from.
        n_val: validation frames.
    """

    def __init__(self, stages_root: Path, n_val: int) -> None:
        self.stages_root, self.n_val = stages_root, n_val
        self._networks: dict[str, NetworkCost] = {}
        self._rates: dict[tuple[str, str], _Rates] = {}  # by network and stage name
        self._medians: dict[tuple[str, str], tuple[float, float] | None] = {}
        self._learned: dict[str, int] = {}  # of each stage that was read, its newest checkpoint
        self._examples: dict[str, Stage] = {}  # of each network, a stage that was read
        self._kinds: dict[str, str] = {}
        self._speed: float | None = None

    def cost(self, stage: Stage) -> Cost:
        """Of one stage, from its first step to its last."""
        if is_command(stage.config):
            return self._of_command(stage)
        network = self._network(stage)
        settings = read_stage_settings(stage.config)
        n_checkpoints = len(checkpoint_epochs(stage))
        trained = stage.steps * settings.batch_size * (1 + BACKWARD)
        looked_at = n_checkpoints * self.n_val
        flops = network.flops * (trained + looked_at)
        box_bytes = (
            BOX_BYTES + IMAGE_BOX_BYTES * locate(network.target, "detector._target_").IMAGE_BOXES
        )
        boxes = self.n_val * settings.max_boxes * box_bytes
        known = self._known_rate(stage)
        if known is not None:
            step, frame = known
            seconds = stage.steps * step + looked_at * frame
        else:
            seconds = flops / self.speed() * self._slowness(network.target)
        return Cost(
            seconds=seconds,
            flops=flops,
            weights_bytes=n_checkpoints * network.bytes,
            detection_bytes=n_checkpoints * boxes,
            is_measured=known is not None,
        )

    def _of_command(self, stage: Stage) -> Cost:
        """What commands of the same name took; what they compute and write is their own."""
        known = self._known_rate(stage)
        step, frame = known or (0.0, 0.0)
        return Cost(
            seconds=stage.steps * (step + self.n_val * frame),
            flops=0.0,
            weights_bytes=0.0,
            detection_bytes=0.0,
            is_measured=known is not None,
            is_known=known is not None,
        )

    def seconds(self, stage: Stage) -> float:
        """Predicted for one stage, on one slot; where nothing is known of a command, its epochs."""
        cost = self.cost(stage)
        return cost.seconds if cost.is_known else float(stage.epochs)

    def learn(self, keys: Iterable[str] | None = None) -> None:
        """Read how long the checkpoints below the folder took; those that were read before are passed over.

        Args:
            keys: of the stages that may have new ones; None: any.
        """
        paths = (
            sorted(self.stages_root.glob("*-*"))
            if keys is None
            else [self.stages_root / key for key in sorted(keys)]
        )
        for path in paths:
            folder = RunFolder(path)
            steps = folder.steps()
            known = self._learned.get(folder.key, -1)
            if steps and steps[-1] > known:
                self._learned[folder.key] = steps[-1]
                with contextlib.suppress(StoreError):  # cleaned away just now, or torn
                    self._learn(folder, steps, known)

    def _learn(self, folder: RunFolder, steps: Sequence[int], known: int) -> None:
        """Read those of a stage's checkpoints that are newer than the one that is known."""
        spec = read_spec(folder)
        stage, n_val = spec.stage, len(spec.machine.val_ids)
        kind = self._kind(stage)
        self._examples.setdefault(kind, stage)
        for before, step in pairwise([stage.start_step, *steps]):
            if step <= known:
                continue
            with contextlib.suppress(FileNotFoundError, CheckpointError):  # likewise
                seconds = read_marker(folder, step).seconds
                if all(name in seconds for name in PURPOSES):
                    rates = self._rates.setdefault((kind, stage.name), _Rates())
                    rates.steps.append(seconds["training"] / _steps_between(stage, before, step))
                    rates.frames.append((seconds["detection"] + seconds["scoring"]) / n_val)
                    self._medians.clear()

    def _known_rate(self, stage: Stage) -> tuple[float, float] | None:
        """The median of stages of the same name, or else of any stage of the same network."""
        kind = self._kind(stage)
        if (kind, stage.name) not in self._medians:
            own = self._rates.get((kind, stage.name))
            same = [rates for (other, _), rates in self._rates.items() if other == kind]
            self._medians[kind, stage.name] = _median([own] if own else same)
        return self._medians[kind, stage.name]

    def _slowness(self, target: str) -> float:
        """How much longer than their FLOPs say a detector's other networks took a step; 1: none was seen."""
        for stage in self._examples.values():
            if stage.target == target and not is_command(stage.config):
                with contextlib.suppress(ConfigError):  # an older version's
                    self._network(stage)
        found = [
            statistics.median(rates.steps) * self.speed() / self._networks[kind].step_flops
            for (kind, _), rates in self._rates.items()
            if kind in self._networks and self._networks[kind].target == target
        ]
        return statistics.median(found) if found else 1.0

    def _network(self, stage: Stage) -> NetworkCost:
        kind = self._kind(stage)
        if kind not in self._networks:
            self._networks[kind] = network_cost(stage.config)
        return self._networks[kind]

    def _kind(self, stage: Stage) -> str:
        """Stages of one kind have the same network and take the same time a step."""
        if stage.key not in self._kinds:
            self._kinds[stage.key] = sys.intern(_kind(stage.config))
        return self._kinds[stage.key]

    def speed(self) -> float:
        """FLOP/s of one thread of this machine at convolutions, measured once, in a fifth of a second."""
        if self._speed is None:
            self._speed = measure_speed()
        return self._speed


def _kind(config: Config) -> str:
    if is_command(config):
        return digest([config["detector"]["name"], config["detector"]["program"]["folder"]])
    settings = read_stage_settings(config)
    optimizer = config["optimizer"]["_target_"]
    arithmetic = (settings.precision, settings.compile)
    return digest([config["detector"], optimizer, settings.batch_size, config["data"], *arithmetic])


def _steps_between(stage: Stage, before: int, step: int) -> int:
    """Steps of training from one checkpoint to the next; a command may write results of some epochs only."""
    if is_command(stage.config):
        return step - before
    return stage.epoch_steps * checkpoint_every(stage)


def _median(several: Sequence[_Rates]) -> tuple[float, float] | None:
    """Seconds of a step and of a frame; None: nothing was read."""
    if not several:
        return None
    return (
        statistics.median(chain.from_iterable(rates.steps for rates in several)),
        statistics.median(chain.from_iterable(rates.frames for rates in several)),
    )


def checkpoint_epochs(stage: Stage) -> list[int]:
    """A stage's own epochs after which it has a checkpoint; of a command each may have one."""
    every = 1 if is_command(stage.config) else checkpoint_every(stage)
    return sorted({*range(every, stage.epochs + 1, every), stage.epochs})


def checkpoint_every(stage: Stage) -> int:
    """Epochs between the checkpoints of a network."""
    return read_stage_settings(stage.config).checkpoint_every
