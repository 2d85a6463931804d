"""Run a plan: ready stages go to the launcher, longest remaining path first; a failure stops only its descendants."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fl3d.errors import StageFailed
from fl3d.leases import holder_of
from fl3d.records import Config, Stage, StagePaths
from fl3d.sweep.launchers.base import Job, JobState, Launcher, LauncherBusy
from fl3d.sweep.plan import Plan, longest_paths
from fl3d.training.run import write_spec

MAX_TRIES = 3  # of a stage that was killed
POLL_SECONDS = 0.2
BUSY_SECONDS = 30.0  # before a launcher that refused a stage is asked again


@dataclass
class Outcome:
    """What became of a plan's stages.

    Args:
        trained: keys that were trained now.
        reused: keys that were done before.
        stopped: keys that were ended before their last epoch, as the sweeper wished.
        failed: keys, each with its traceback.
        blocked: keys whose ancestors failed.
    """

    trained: list[str] = field(default_factory=list)
    reused: list[str] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    blocked: list[str] = field(default_factory=list)

    def ended(self) -> set[str]:
        """Keys that will not be trained any further, though they are not done."""
        return {*self.stopped, *self.failed, *self.blocked}

    def check(self) -> None:
        """Raise if anything failed.

        Raises:
            StageFailed: names each failed stage, with the last line of its traceback.
        """
        if self.failed:
            reasons = "\n".join(f"  {key}: {trace.strip().splitlines()[-1]}" for key, trace in self.failed.items())
            raise StageFailed(f"{len(self.failed)} stage(s) failed, {len(self.blocked)} could not start:\n{reasons}")


class Scheduler:
    """Runs the stages of a plan; the plan may grow while it does.

    Args:
        plan: what to run.
        machine: settings of this machine, see ``training.run.write_spec``.
        launcher: where.
        stages_root: folder of all stages.
        seconds: predicted for each stage; the longest path is started first. None: its steps count instead.
        on_tick: called about five times a second with the stages that run now; may grow the plan and stop stages.
        on_failure: called at once with a stage and its traceback.
    """

    def __init__(
        self,
        plan: Plan,
        machine: Config,
        launcher: Launcher,
        stages_root: Path,
        seconds: Callable[[Stage], float] | None = None,
        on_tick: Callable[[list[Stage]], None] = lambda running: None,
        on_failure: Callable[[Stage, str], None] = lambda stage, trace: None,
    ) -> None:
        self.plan, self.machine, self.launcher = plan, machine, launcher
        self.stages_root, self.on_tick, self.on_failure = stages_root, on_tick, on_failure
        self.seconds = seconds or (lambda stage: float(stage.steps))
        self.outcome = Outcome()
        self._done: set[str] = set()
        self._running: dict[str, Job] = {}
        self._elsewhere: set[str] = set()
        self._tries: dict[str, int] = {}  # since a stage last got on
        self._newest: dict[str, int] = {}  # step, when a stage was started
        self._wait_until = 0.0
        self._saw: set[str] = set()

    def paths(self, key: str) -> StagePaths:
        """Files of a stage."""
        return StagePaths(self.stages_root / key)

    def run(self) -> Outcome:
        """Train every stage that is not done; Ctrl-C ends the running ones and passes on."""
        try:
            while True:
                self._collect()
                self._look()
                self._start_ready()  # before anything that waits for a store
                self.on_tick([self.plan.stages[key] for key in self._running])
                if not self._running and not self._elsewhere and not self._has_news():
                    break
                time.sleep(POLL_SECONDS)
        finally:
            for job in self._running.values():
                job.cancel()
            self.launcher.close()
        self.on_tick([])
        return self.outcome

    @property
    def elsewhere(self) -> set[str]:
        """Keys of stages that are ready, and that another sweep trains."""
        return self._elsewhere

    def stop(self, key: str) -> None:
        """End a stage before its last epoch; what it has done stays."""
        if key not in self._done and key not in self.outcome.ended():
            self.outcome.stopped.append(key)
            job = self._running.pop(key, None)
            if job is not None:
                job.cancel()

    def _has_news(self) -> bool:
        """Whether the plan holds stages that this scheduler has not seen: they may be done, and then are news."""
        return not self._saw.issuperset(self.plan.stages)

    def _look(self) -> None:
        """See which stages are done, by us or by others."""
        for key in self.plan.stages:
            is_new = key not in self._saw
            self._saw.add(key)
            if key not in self._done and key not in self._running and self.paths(key).done.exists():
                self._done.add(key)
                if is_new or key in self._elsewhere:
                    self.outcome.reused.append(key)

    def _start_ready(self) -> None:
        self._elsewhere = set()
        if len(self._running) >= self.launcher.slots or time.monotonic() < self._wait_until:
            return
        ready = [stage for stage in self.plan.stages.values() if self._is_ready(stage)]
        if ready:
            longest = longest_paths(self.plan, self._todo())
            ready.sort(key=lambda stage: -longest[stage.key])
        for stage in ready:
            if len(self._running) >= self.launcher.slots:
                break
            if holder_of(self.paths(stage.key).lease) is not None:
                self._elsewhere.add(stage.key)  # another sweep trains it; it will be done, or its lease will end
                continue
            if not self._launch(stage):
                break

    def _launch(self, stage: Stage) -> bool:
        """Give a stage to the launcher; False where that takes no more for a while."""
        paths = self.paths(stage.key)
        write_spec(paths, stage, self.machine)
        parent = self._running.get(stage.parent) if stage.parent else None
        try:
            self._running[stage.key] = self.launcher.launch(paths.folder, parent)
        except LauncherBusy:
            if not self._running:
                raise
            self._wait_until = time.monotonic() + BUSY_SECONDS
            return False
        newest = max(paths.steps(), default=-1)
        if newest > self._newest.get(stage.key, -1):
            self._tries[stage.key] = 0  # it got on since it was killed last
        self._newest[stage.key] = newest
        self._tries[stage.key] = self._tries.get(stage.key, 0) + 1
        return True

    def _todo(self) -> Mapping[str, float]:
        return {k: self.seconds(stage) for k, stage in self.plan.stages.items() if k not in self._done}

    def _is_ready(self, stage: Stage) -> bool:
        if stage.key in self._running or stage.key in self._done or stage.key in self.outcome.ended():
            return False
        if stage.parent is None or stage.parent in self._done:
            return True
        return self.launcher.has_queue and stage.parent in self._running

    def _collect(self) -> None:
        for key, job in list(self._running.items()):
            state = job.state()
            if not state.is_finished():
                continue
            del self._running[key]
            if self.paths(key).done.exists():
                self._done.add(key)
                self.outcome.trained.append(key)
            elif self._parent_is_lost(key) or holder_of(self.paths(key).lease) is not None:
                continue  # or another sweep has taken it over
            elif state is not JobState.KILLED or self._tries[key] >= MAX_TRIES:
                self._fail(key, state)

    def _parent_is_lost(self, key: str) -> bool:
        """Whether a stage could not start as its parent is not whole or has not ended; that is trained first."""
        parent = self.plan.stages[key].parent
        if parent is None or self.paths(parent).done.exists():
            return False
        if parent not in self._done:
            return parent not in self.outcome.ended()
        if self._tries[key] >= MAX_TRIES:
            return False
        self._done.discard(parent)
        return True

    def _fail(self, key: str, state: JobState) -> None:
        error = self.paths(key).error
        trace = error.read_text() if error.exists() and state is not JobState.KILLED else ""
        if not trace:
            killed = f"killed {self._tries[key]} times since it last got on"
            trace = killed if state is JobState.KILLED else "ended without a traceback; see the logs in its folder"
        self.outcome.failed[key] = trace
        stopped = {key}
        for stage in self.plan.stages.values():
            if stage.parent in stopped:
                stopped.add(stage.key)
                self.outcome.blocked.append(stage.key)
                self._running.pop(stage.key, _Nothing()).cancel()
        self.on_failure(self.plan.stages[key], trace)


class _Nothing(Job):
    """Stands for a stage that was not launched."""

    def state(self) -> JobState:
        return JobState.KILLED

    def cancel(self) -> None:
        pass


def steps_done(paths: StagePaths, stage: Stage) -> int:
    """Steps of its own that a stage has behind it, by its progress file."""
    if paths.done.exists():
        return stage.steps
    try:
        return int(json.loads(paths.progress.read_text())["step"])
    except (OSError, ValueError, KeyError):
        return 0
