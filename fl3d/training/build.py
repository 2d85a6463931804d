"""From a stage's config to the objects that train it."""

from __future__ import annotations

from typing import Any

import torch

from fl3d.config import build
from fl3d.data.augment import Augmentation
from fl3d.detectors.base import Detector
from fl3d.evaluation.protocol import Protocol
from fl3d.records import Config
from fl3d.training.rates import OneCycle, StepDecay
from fl3d.training.trainer import Schedule


def build_detector(config: Config) -> Detector:
    """The network of a stage, with fresh weights from torch's generator."""
    detector = build(config["detector"], "detector", loss=build(config["loss"], "loss"))
    assert isinstance(detector, Detector), f"detector._target_ must name a Detector, not {type(detector).__name__}"
    return detector


def build_optimizer(config: Config, detector: Detector) -> torch.optim.Optimizer:
    """The optimiser over a detector's parameters, but for those that are frozen."""
    parameters = [parameter for parameter in detector.parameters() if parameter.requires_grad]
    optimizer: torch.optim.Optimizer = build(config["optimizer"], "optimizer", params=parameters)
    return optimizer


def build_augmentation(config: Config) -> Augmentation | None:
    """What changes training frames; None where nothing does."""
    if config["augment"] is None:
        return None
    augmentation: Augmentation = build(config["augment"], "augment")
    return augmentation


def build_schedule(config: Config, machine: Config) -> Schedule:
    """The schedule of a stage."""
    values: dict[str, Any] = dict(config["schedule"])
    own = values.pop("stage")
    for key, kind in (("one_cycle", OneCycle), ("decay", StepDecay)):
        values[key] = None if values[key] is None else kind(**values[key])
    return Schedule(lr_factor=own["lr_factor"], save_every_steps=machine["save_every_steps"], **values)


def build_protocol(values: Config) -> Protocol:
    """The protocol that checkpoints are scored under."""
    return Protocol(**values)
