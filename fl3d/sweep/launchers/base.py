"""The one interface of all launchers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from pathlib import Path

from fl3d.core.errors import Fl3dError


class LauncherBusy(Fl3dError):
    """It takes no more stages for a while, such as a queue that is full."""


class JobState(Enum):
    """What has become of a stage that was launched."""

    RUNNING = "running"  # or waiting in the launcher's own queue
    DONE = "done"
    RAISED = "raised"  # it failed by itself; trying again would fail again
    KILLED = "killed"  # something ended it; worth another try

    def is_finished(self) -> bool:
        """Whether it will not change any more."""
        return self is not JobState.RUNNING


class Job(ABC):
    """A stage that was launched."""

    @abstractmethod
    def state(self) -> JobState:
        """Where it stands, without waiting."""

    @abstractmethod
    def cancel(self) -> None:
        """End it; its last checkpoint stays."""


class Launcher(ABC):
    """Starts stages somewhere.

    Attributes:
        slots: how many stages it is given at once.
        has_queue: whether it takes a stage whose parent still runs, and starts it afterwards by itself.
        IS_HERE: whether its stages run on this machine, with its devices.
    """

    slots: int
    has_queue: bool = False
    IS_HERE: bool = False

    @abstractmethod
    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Start the stage whose spec lies in a folder.

        Args:
            folder: of the stage.
            after: the parent's job where that still runs; given to launchers that have a queue alone.
        """

    def open(self) -> None:  # noqa: B027
        """Get ready to launch; may be called again. What only asks for ``slots`` need not open it."""

    def close(self) -> None:  # noqa: B027
        """Let go of whatever the launcher holds."""
