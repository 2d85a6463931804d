"""The rounds of a sweep that adds seeds: after which numbers of seeds it looks. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from fl3d.core.errors import ConfigError
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
                raise ConfigError(f"{WHERE}.{name}: {count} is not a whole number of at least 1")
        if self.first < FEWEST:
            raise ConfigError(
                f"{WHERE}.first: {self.first}, but a verdict needs at least {FEWEST} seeds"
            )
        if self.most < self.first:
            raise ConfigError(
                f"{WHERE}.most: {self.most} is less than the {self.first} seeds of the first round"
            )
        hours = self.hours
        if hours is not None and (isinstance(hours, bool) or not hours > 0):
            raise ConfigError(f"{WHERE}.hours: {hours}; give hours of work above 0, or null")

    @property
    def looks(self) -> tuple[int, ...]:
        """Numbers of seeds at the end of each round, the last at ``most``."""
        return (*range(self.first, self.most, self.step), self.most)

    def after(self, n_seeds: int) -> int | None:
        """Number of seeds of the round that follows; None: there is none."""
        return next((look for look in self.looks if look > n_seeds), None)
