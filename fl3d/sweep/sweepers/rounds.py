"""The rounds of a sweep that adds seeds: after which numbers of seeds it looks. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from fl3d.config.seeds import MOST
from fl3d.core.errors import ConfigError, options
from fl3d.evaluation.verdicts import FEWEST

WHERE = "hydra.sweeper"


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """How seeds are added.

    Args:
        first: seeds of the first round.
        most: seeds at most.
        step: seeds that a round adds.
        hours: of work that the next round must not go past; None: whatever it takes.

    Raises:
        ConfigError: counts that do not go together.
    """

    first: int = FEWEST
    most: int = 10
    step: int = 1
    hours: float | None = None

    def __post_init__(self) -> None:
        """Refuse counts that do not go together."""
        for name in ("first", "most", "step"):
            count = getattr(self, name)
            if not isinstance(count, int) or isinstance(count, bool) or count < 1:
                shown = "null" if count is None else count
                raise ConfigError(f"{WHERE}.{name}: {shown} is not a whole number of at least 1")
        if self.first < FEWEST:
            raise ConfigError(
                f"{WHERE}.first: {self.first}, but a verdict needs at least {FEWEST} seeds"
            )
        if self.most < self.first:
            raise ConfigError(
                f"{WHERE}.most: {self.most} is less than the {self.first} seeds of the first round"
            )
        if self.most > MOST:
            raise ConfigError(
                f"{WHERE}.most: {self.most} is more than the {MOST} seeds that a sweep may have"
            )
        hours = self.hours
        is_number = isinstance(hours, int | float) and not isinstance(hours, bool)
        if hours is not None and not (is_number and math.isfinite(hours) and hours > 0):
            raise ConfigError(f"{WHERE}.hours: {hours}; give hours of work above 0, or null")

    @property
    def looks(self) -> tuple[int, ...]:
        """Numbers of seeds at the end of each round, the last at ``most``."""
        return (*range(self.first, self.most, self.step), self.most)

    def after(self, n_seeds: int) -> int | None:
        """Number of seeds of the round that follows; None: there is none."""
        return next((look for look in self.looks if look > n_seeds), None)


def rounds_of(settings: Mapping[str, object]) -> Rounds:
    """The rounds that a config says.

    Raises:
        ConfigError: a key that there is not, or counts that do not go together.
    """
    own = {field.name for field in fields(Rounds)}
    unknown = sorted(set(settings) - own)
    if unknown:
        raise ConfigError(
            f"{WHERE}.{unknown[0]}: hydra/sweeper=until_decided has no such key. {options(unknown[0], own)}"
        )
    return Rounds(**settings)  # type: ignore[arg-type]
