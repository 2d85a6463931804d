"""From a stage's config to the objects that train it."""

from __future__ import annotations

from typing import Any

import torch

from fl3d.config.objects import build
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config
from fl3d.data.augment import Augmentation
from fl3d.detectors.base import Detector
from fl3d.training.rates import OneCycle, StepDecay
from fl3d.training.trainer import Schedule


def build_optimizer(config: Config, detector: Detector) -> torch.optim.Optimizer:
    """The optimiser over a detector's parameters, but for those that are frozen.

    Raises:
        ConfigError: the config names none, or one that cannot be built.
    """
    if not config.get("optimizer"):
        raise ConfigError(
            "optimizer: none is given; the detector's YAML must have one, such as "
            "optimizer: {_target_: torch.optim.Adam, lr: 0.001}"
        )
    parameters = [parameter for parameter in detector.parameters() if parameter.requires_grad]
    optimizer: torch.optim.Optimizer = build(config["optimizer"], "optimizer", params=parameters)
    for group in optimizer.param_groups:
        if (
            "foreach" in group and group["foreach"] is None
        ):  # all parameters in few calls; the same bits
            group["foreach"] = True
    return optimizer


def build_augmentation(config: Config) -> Augmentation | None:
    """What changes training frames; None where nothing does."""
    if config["augment"] is None:
        return None
    augmentation: Augmentation = build(config["augment"], "augment")
    return augmentation


def build_schedule(config: Config, save_every_steps: int | None = None) -> Schedule:
    """The schedule of a stage, with resume points every so many steps."""
    values: dict[str, Any] = dict(config["schedule"])
    own = values.pop("stage")
    for key, kind in (("one_cycle", OneCycle), ("decay", StepDecay)):
        values[key] = None if values[key] is None else kind(**values[key])
    return Schedule(lr_factor=own["lr_factor"], save_every_steps=save_every_steps, **values)
