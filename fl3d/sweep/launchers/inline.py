"""Run each stage in this very process: for debuggers and tests."""

from __future__ import annotations

from pathlib import Path

from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.training.stage import run_stage


class _Finished(Job):
    def __init__(self, state: JobState) -> None:
        self._state = state

    def state(self) -> JobState:
        return self._state

    def cancel(self) -> None:
        pass


class InlineLauncher(Launcher):
    """One stage at a time; ``launch`` returns when it has ended."""

    IS_HERE = True

    slots = 1

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Run the stage to its end."""
        try:
            run_stage(folder)
        except Exception:
            return _Finished(JobState.RAISED)
        return _Finished(JobState.DONE)
