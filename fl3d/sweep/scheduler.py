"""Run a plan: ready stages go to the launcher, longest remaining path first; a failure stops only its descendants."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from fl3d.core.errors import StageFailed, Unwritable
from fl3d.core.files import ROOM, check_writable
from fl3d.core.leases import holder_of
from fl3d.core.records import Stage
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import Machine, Spec, write_spec
from fl3d.sweep.launchers.base import Job, JobState, Launcher, LauncherBusy
from fl3d.sweep.plan import Plan, longest_paths

MAX_TRIES = 3  # of a stage that was killed
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
        done: keys that are trained to their end, by whom and whenever.
    """

    trained: list[str] = field(default_factory=list)
    reused: list[str] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    blocked: list[str] = field(default_factory=list)
    done: set[str] = field(default_factory=set)

    def ended(self) -> set[str]:
        """Keys that will not be trained any further, though they are not done."""
        return {*self.stopped, *self.failed, *self.blocked}

    def check(self) -> None:
        """Raise if anything failed.

        Raises:
            StageFailed: names each failed stage, with the last line of its traceback.
        """
        if self.failed:
            reasons = "\n".join(
                f"  {key}: {trace.strip().splitlines()[-1]}" for key, trace in self.failed.items()
            )
            raise StageFailed(
                f"{len(self.failed)} stage(s) failed, {len(self.blocked)} could not start:\n{reasons}"
            )


class Scheduler:
    """Runs the stages of a plan, step by step; between two steps the plan may have grown.

    Args:
        machine: settings of this machine.
        launcher: where stages run.
        layout: of the store folder.
        seconds: predicted for each stage; the longest path is started first. None: its steps count instead.
    """

    def __init__(
        self,
        machine: Machine,
        launcher: Launcher,
        layout: StoreFolder,
        seconds: Callable[[Stage], float] | None = None,
    ) -> None:
        self.machine = machine
        self.launcher = launcher
        self.layout = layout
        self.seconds = seconds or (lambda stage: float(stage.steps))
        self.outcome = Outcome()
        self.elsewhere: set[str] = set()  # ready, and in training by another sweep
        self._running: dict[str, Job] = {}
        self._seen: set[str] = set()
        self._tries: dict[str, int] = {}  # of a stage since it last made progress
        self._newest: dict[str, int] = {}  # step, when a stage was started
        self._wait_until = 0.0  # when a launcher that refused a stage is asked again; 0: it has not

    @property
    def running(self) -> list[str]:
        """Keys of the stages that run now."""
        return list(self._running)

    def step(self, plan: Plan) -> None:
        """Collect the stages that ended, and start those that are ready."""
        self._collect(plan)
        self._look(plan)
        self._start_ready(plan)

    def is_idle(self, plan: Plan) -> bool:
        """Whether there is nothing to wait for; stages that it has not seen yet may be done, and then are news."""
        is_waiting = bool(self._running or self.elsewhere or self._wait_until)
        return not is_waiting and self._seen.issuperset(plan.stages)

    def stop(self, keys: Iterable[str]) -> None:
        """End stages before their last epoch; what they have done stays."""
        for key in keys:
            if key not in self.outcome.done and key not in self.outcome.ended():
                self.outcome.stopped.append(key)
                self._cancel(key)

    def close(self) -> None:
        """End the running stages, and let go of the launcher."""
        for job in self._running.values():
            job.cancel()
        self.launcher.close()

    def _cancel(self, key: str) -> None:
        job = self._running.pop(key, None)
        if job is not None:
            job.cancel()

    def _look(self, plan: Plan) -> None:
        """See which stages are done, by us or by others."""
        for key in plan.stages:
            is_new = key not in self._seen
            self._seen.add(key)
            if key in self.outcome.done or key in self._running:
                continue
            if self.layout.run(key).is_done:
                self.outcome.done.add(key)
                if is_new or key in self.elsewhere:
                    self.outcome.reused.append(key)

    def _start_ready(self, plan: Plan) -> None:
        self.elsewhere = set()
        if len(self._running) >= self.launcher.slots or time.monotonic() < self._wait_until:
            return
        self._wait_until = 0.0
        ready = [stage for stage in plan.stages.values() if self._is_ready(stage)]
        if ready:
            longest = longest_paths(plan, self._todo(plan))
            ready.sort(key=lambda stage: -longest[stage.key])
        for stage in ready:
            if len(self._running) >= self.launcher.slots:
                break
            if holder_of(self.layout.run(stage.key).lease) is not None:
                self.elsewhere.add(stage.key)  # it will be done, or its lease will end
                continue
            if not self._launch(stage):
                break

    def _launch(self, stage: Stage) -> bool:
        """Give a stage to the launcher; False where that takes no more for a while."""
        folder = self.layout.run(stage.key)
        write_spec(folder, Spec(stage, self.machine))
        parent = self._running.get(stage.parent) if stage.parent else None
        try:
            self._running[stage.key] = self.launcher.launch(folder.path, parent)
        except LauncherBusy:
            if not self._running:
                raise
            self._wait_until = time.monotonic() + BUSY_SECONDS
            return False
        self._count_try(folder)
        return True

    def _count_try(self, folder: RunFolder) -> None:
        newest = max(folder.steps(), default=-1)
        if newest > self._newest.get(folder.key, -1):
            self._tries[folder.key] = 0  # it made progress since it was killed last
        self._newest[folder.key] = newest
        self._tries[folder.key] = self._tries.get(folder.key, 0) + 1

    def _todo(self, plan: Plan) -> Mapping[str, float]:
        done = self.outcome.done
        return {key: self.seconds(stage) for key, stage in plan.stages.items() if key not in done}

    def _is_ready(self, stage: Stage) -> bool:
        if (
            stage.key in self._running
            or stage.key in self.outcome.done
            or stage.key in self.outcome.ended()
        ):
            return False
        if stage.parent is None or stage.parent in self.outcome.done:
            return True
        return self.launcher.has_queue and stage.parent in self._running

    def _collect(self, plan: Plan) -> None:
        for key, job in list(self._running.items()):
            state = job.state()
            if not state.is_finished():
                continue
            del self._running[key]
            folder = self.layout.run(key)
            if folder.is_done:
                self.outcome.done.add(key)
                self.outcome.trained.append(key)
            elif self._parent_is_lost(plan, key) or holder_of(folder.lease) is not None:
                continue  # or another sweep has taken it over
            elif state is not JobState.KILLED or self._tries[key] >= MAX_TRIES:
                self._fail(plan, folder, state)

    def _parent_is_lost(self, plan: Plan, key: str) -> bool:
        """Whether a stage could not start as its parent is not whole or has not ended; that is trained first."""
        parent = plan.stages[key].parent
        if parent is None or self.layout.run(parent).is_done:
            return False
        if parent not in self.outcome.done:
            return parent not in self.outcome.ended()
        if self._tries[key] >= MAX_TRIES:
            return False
        self.outcome.done.discard(parent)
        return True

    def _fail(self, plan: Plan, folder: RunFolder, state: JobState) -> None:
        self.outcome.failed[folder.key] = self._reason(folder, state)
        lost = {folder.key}
        for stage in plan.stages.values():
            if stage.parent in lost:
                lost.add(stage.key)
                self.outcome.blocked.append(stage.key)
                self._cancel(stage.key)

    def _reason(self, folder: RunFolder, state: JobState) -> str:
        if state is JobState.KILLED:
            return f"killed {self._tries[folder.key]} times without making progress"
        trace = folder.error.read_text(encoding="utf-8") if folder.error.exists() else ""
        return (
            trace or _unwritable(folder) or "ended without a traceback; see the logs in its folder"
        )


def _unwritable(folder: RunFolder) -> str:
    """Why a stage could not even say what was wrong; nothing where it could have."""
    try:
        check_writable(folder.path, ROOM)
    except Unwritable as error:
        return str(error)
    return ""
