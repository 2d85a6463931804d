"""How learning rates change over a stage: functions of where it stands, so that an interrupted one resumes alike."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi
from typing import Any

from fl3d.core.errors import ConfigError


@dataclass(frozen=True)
class OneCycle:
    """Half a cosine up, half a cosine down, with the momentum against it.

    Smith and Topin: Super-Convergence: Very Fast Training of Neural Networks Using Large Learning Rates. 2018.

    Args:
        start: of the learning rate at the first step, as a factor.
        rise: share of the stage after which it has reached one.
        end: factor at the last step.
        momentum: at the lowest and at the highest learning rate (Adam's first beta).

    Raises:
        ConfigError: a share or momentum out of its range.
    """

    start: float
    rise: float
    end: float
    momentum: tuple[float, float]

    def __post_init__(self) -> None:
        if not 0 < self.rise < 1:
            raise ConfigError(
                f"schedule.one_cycle.rise: {self.rise} is not a share between 0 and 1"
            )
        if not all(0 <= value < 1 for value in self.momentum):
            raise ConfigError(
                f"schedule.one_cycle.momentum: {list(self.momentum)} are not two numbers in [0, 1)"
            )

    def factor(self, progress: float) -> float:
        """Of the learning rate, where a share of the stage is done."""
        return self._between(progress, self.start, 1.0, self.end)

    def set_momentum(self, group: dict[str, Any], progress: float) -> None:
        """Set the momentum of an optimiser's group."""
        value = self._between(progress, self.momentum[0], self.momentum[1], self.momentum[0])
        if "betas" in group:
            group["betas"] = (value, *group["betas"][1:])
        elif "momentum" in group:
            group["momentum"] = value

    def _between(self, progress: float, first: float, middle: float, last: float) -> float:
        if progress < self.rise:
            return middle + (first - middle) * (1 + cos(pi * progress / self.rise)) / 2
        return last + (middle - last) * (1 + cos(pi * (progress - self.rise) / (1 - self.rise))) / 2


@dataclass(frozen=True)
class StepDecay:
    """A learning rate that falls by a factor every so many epochs.

    Args:
        every: epochs.
        factor: by which it falls.
        lowest: factor that it does not fall below.

    Raises:
        ConfigError: no epochs, or a factor out of its range.
    """

    every: int
    factor: float
    lowest: float

    def __post_init__(self) -> None:
        if self.every < 1 or not 0 < self.factor <= 1:
            raise ConfigError(
                f"schedule.decay: every {self.every} epochs by {self.factor} is no decay"
            )

    def of(self, epoch: int) -> float:
        """Factor after so many epochs of the stage."""
        return max(float(self.factor ** (epoch // self.every)), self.lowest)
