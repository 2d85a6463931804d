"""The one interface of all sweepers: they propose trials, and may listen to how those do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from fl3d.core.records import Config, Trial

Compose = Callable[[Sequence[str]], Config]


@dataclass(frozen=True)
class Point:
    """A trial as a sweeper proposes it.

    Args:
        overrides: what makes it differ from the sweep's other trials, as the user wrote it.
        values: the same as data: swept values by key, in the order of the overrides.
        config: fully resolved.
    """

    overrides: tuple[str, ...]
    values: Mapping[str, Any]
    config: Config


class TrialState(Enum):
    """What has become of a trial."""

    RUNNING = "running"  # or waiting to run
    DONE = "done"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class Standing:
    """How a trial stands.

    Args:
        trial: which.
        state: what has become of it.
        curve: metrics of its last stage's checkpoints, by the epochs that this stage had behind
            it, rising.
        epochs: of its last stage.
    """

    trial: Trial
    state: TrialState
    curve: Mapping[int, Mapping[str, float]]
    epochs: int


@dataclass(frozen=True)
class Advice:
    """What a sweeper wants done.

    Args:
        points: trials to add.
        stop: keys of trials to end now, or not to begin.
    """

    points: Sequence[Point] = field(default_factory=tuple)
    stop: Sequence[str] = field(default_factory=tuple)


class Sweeper(ABC):
    """Proposes the trials of a sweep.

    Attributes:
        base: a config of the sweep: what all its trials share.
        swept: keys in which its trials differ, in order.
        listens: whether ``advise`` wants to hear how trials stand.
        n_trials: how many it may propose in all.
    """

    base: Config
    swept: tuple[str, ...] = ()
    listens: bool = False
    n_trials: int

    @abstractmethod
    def first(self) -> Sequence[Point]:
        """Trials that are known before any is trained; asked once, and again by ``plan``."""

    def open(self, identify: Callable[[Point], str]) -> None:  # noqa: B027
        """Get ready to advise; what it keeps on disk is opened here, and not when a plan is made.

        Args:
            identify: the key of a point's trial; equal for points that are one trial.
        """

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        """Hear how all trials stand, and say what to do.

        Args:
            standings: of the sweep's trials, by key.
            slots: stages that run at once.
        """
        return Advice()

    def report(self, standings: Mapping[str, Standing], folder: Path) -> str:
        """What the sweeper itself has found, as Markdown; empty where tables say it all.

        Args:
            standings: of the sweep's trials, by key.
            folder: of the sweep's results, for tables of its own.
        """
        return ""
