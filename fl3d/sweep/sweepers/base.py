"""The one interface of all sweepers: they propose trials, and may listen to how those do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import pandas as pd

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


@dataclass(frozen=True)
class Work:
    """What a sweep has cost, and what some more trials would.

    Args:
        done: seconds of training, detection and scoring in all stages of the sweep and of these trials, by whichever
            start, or other sweep.
        left: seconds of the same that are predicted until the trials are done.
        wait: seconds until then on the slots that there are.
    """

    done: float
    left: float
    wait: float


class Evidence(ABC):
    """What a sweeper may look up of a sweep that runs.

    Attributes:
        factor: keys that are compared.
        margin: of the verdicts, AP.
        looks_before: numbers of seeds after which an earlier start of the sweep asked for verdicts; empty: none did.
    """

    factor: tuple[str, ...]
    margin: float
    looks_before: tuple[int, ...]

    @abstractmethod
    def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
        """The verdicts that ``gains`` would print now: rows of ``analysis.verdicts.verdicts``.

        Args:
            standings: of the sweep's trials; those that are done are looked at. Where none has a gain there is no row.
        """

    @abstractmethod
    def work(self, standings: Mapping[str, Standing], points: Sequence[Point], slots: int) -> Work:
        """What the sweep has cost so far, and what some more points would.

        Args:
            standings: of the sweep's trials.
            points: that might be added.
            slots: stages that run at once.
        """

    @abstractmethod
    def say(self, text: str) -> None:
        """Print a line for the user."""


class Sweeper(ABC):
    """Proposes the trials of a sweep.

    Attributes:
        base: a config of the sweep: what all its trials share.
        swept: keys in which its trials differ, in order.
        listens: whether ``advise`` wants to hear how trials learn, and adds levels while they do.
        n_trials: how many it may propose in all.
        looks: numbers of seeds after which it asks for verdicts; empty: it does not.
    """

    base: Config
    swept: tuple[str, ...] = ()
    listens: bool = False
    n_trials: int
    looks: tuple[int, ...] = ()

    @abstractmethod
    def first(self) -> Sequence[Point]:
        """Trials that are known before any is trained; asked once, and again by ``plan``."""

    def open(self, identify: Callable[[Point], str]) -> None:  # noqa: B027
        """Get ready to advise; what it keeps on disk is opened here, and not when a plan is made.

        Args:
            identify: the key of a point's trial; equal for points that are one trial.
        """

    def consult(self, evidence: Evidence) -> None:  # noqa: B027
        """Be given what may be looked up while the sweep runs; once, before the first ``advise``.

        Args:
            evidence: reads what trials have left on disk.
        """

    def outlook(self) -> str:
        """What will follow the first trials, as a sentence; empty: nothing."""
        return ""

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
