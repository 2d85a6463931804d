"""Run a plan: ready stages go to the launcher, longest remaining path first; a failure stops only its descendants."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from fl3d.errors import StageFailed
from fl3d.records import Config, Stage, StagePaths
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.sweep.plan import Plan, remaining_steps
from fl3d.training.run import write_spec

MAX_TRIES = 3  # of a stage that was killed
POLL_SECONDS = 0.2


@dataclass
class Outcome:
    """What became of a plan's stages.

    Args:
        trained: keys that were trained now.
        reused: keys that were done before.
        failed: keys, each with its traceback.
        blocked: keys whose ancestors failed.
    """

    trained: list[str] = field(default_factory=list)
    reused: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    blocked: list[str] = field(default_factory=list)

    def check(self) -> None:
        """Raise if anything failed.

        Raises:
            StageFailed: names each failed stage, with the last line of its traceback.
        """
        if self.failed:
            reasons = "\n".join(f"  {key}: {trace.strip().splitlines()[-1]}" for key, trace in self.failed.items())
            raise StageFailed(f"{len(self.failed)} stage(s) failed, {len(self.blocked)} could not start:\n{reasons}")


class Scheduler:
    """Runs the stages of a plan.

    Args:
        plan: what to run.
        machine: settings of this machine, see ``training.run.write_spec``.
        launcher: where.
        stages_root: folder of all stages.
        on_tick: called about five times a second with the stages that run now.
        on_failure: called at once with a stage and its traceback.
    """

    def __init__(
        self,
        plan: Plan,
        machine: Config,
        launcher: Launcher,
        stages_root: Path,
        on_tick: Callable[[list[Stage]], None] = lambda running: None,
        on_failure: Callable[[Stage, str], None] = lambda stage, trace: None,
    ) -> None:
        self.plan, self.machine, self.launcher = plan, machine, launcher
        self.stages_root, self.on_tick, self.on_failure = stages_root, on_tick, on_failure
        self.outcome = Outcome()
        self._running: dict[str, Job] = {}
        self._tries: dict[str, int] = {}

    def paths(self, key: str) -> StagePaths:
        """Files of a stage."""
        return StagePaths(self.stages_root / key)

    def run(self) -> Outcome:
        """Train every stage that is not done; Ctrl-C ends the running ones and passes on."""
        self.outcome.reused = [key for key in self.plan.stages if self.paths(key).done.exists()]
        try:
            while True:
                self._collect()
                self._start_ready()
                self.on_tick([self.plan.stages[key] for key in self._running])
                if not self._running:
                    break
                time.sleep(POLL_SECONDS)
        finally:
            for job in self._running.values():
                job.cancel()
            self.launcher.close()
        self.on_tick([])
        return self.outcome

    def _start_ready(self) -> None:
        done = {key: self.paths(key).done.exists() for key in self.plan.stages}
        longest = remaining_steps(self.plan, done)
        ready = [s for s in self.plan.stages.values() if self._is_ready(s, done)]
        ready.sort(key=lambda stage: -longest[stage.key])
        for stage in ready[: self.launcher.slots - len(self._running)]:
            write_spec(self.paths(stage.key), stage, self.machine)
            self._tries[stage.key] = self._tries.get(stage.key, 0) + 1
            self._running[stage.key] = self.launcher.launch(self.paths(stage.key).folder)

    def _is_ready(self, stage: Stage, done: dict[str, bool]) -> bool:
        idle = stage.key not in self._running and stage.key not in self.outcome.failed
        return idle and not done[stage.key] and (stage.parent is None or done[stage.parent])

    def _collect(self) -> None:
        for key, job in list(self._running.items()):
            state = job.state()
            if not state.is_finished():
                continue
            del self._running[key]
            if self.paths(key).done.exists():
                self.outcome.trained.append(key)
            elif state is not JobState.KILLED or self._tries[key] >= MAX_TRIES:
                self._fail(key, state)

    def _fail(self, key: str, state: JobState) -> None:
        error = self.paths(key).error
        trace = error.read_text() if error.exists() and state is not JobState.KILLED else ""
        trace = trace or f"killed {self._tries[key]} times"
        self.outcome.failed[key] = trace
        stopped = {key}
        for stage in self.plan.stages.values():
            if stage.parent in stopped:
                stopped.add(stage.key)
                self.outcome.blocked.append(stage.key)
        self.on_failure(self.plan.stages[key], trace)


def steps_done(paths: StagePaths, stage: Stage) -> int:
    """Steps of its own that a stage has behind it, by its progress file."""
    if paths.done.exists():
        return stage.steps
    try:
        return int(json.loads(paths.progress.read_text())["step"])
    except (OSError, ValueError, KeyError):
        return 0
