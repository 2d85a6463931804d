"""Run a plan: ready stages go to the launcher, longest remaining path first; a failure stops only its descendants."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from fl3d.core.errors import StageFailed, Unwritable
from fl3d.core.files import ROOM, check_writable
from fl3d.core.leases import holder_of
from fl3d.core.records import Stage
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import Machine, Spec, write_spec
from fl3d.sweep.launchers.base import Job, JobState, Launcher, LauncherBusy
from fl3d.sweep.plan import Plan
from fl3d.sweep.ready import Ready

MAX_TRIES = 3  # of a stage that was killed
NAMED = 3  # stages, of those that failed alike
BUSY_SECONDS = 30.0  # before a launcher that refused a stage is asked again


@dataclass
class Outcome:
    """What became of a plan's stages.

    Args:
        trained: keys that were trained now.
        reused: keys that were done before, or by another sweep meanwhile.
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

    def check(self) -> None:
        """Raise if anything failed.

        Raises:
            StageFailed: names failed stages, with the last lines of their tracebacks; equal ones once.
        """
        if self.failed:
            groups: dict[str, list[str]] = {}
            for key in self.failed:
                groups.setdefault(self.kind(key), []).append(key)
            reasons = "\n".join(
                f"  {_named(keys)}: {_last_line(self.failed[keys[0]])}" for keys in groups.values()
            )
            raise StageFailed(
                f"{len(self.failed)} stage(s) failed, {len(self.blocked)} could not start:\n{reasons}"
            )

    def kind(self, key: str) -> str:
        """Why a stage failed, equal for stages that failed alike: its last line without the stage's own name."""
        return re.sub(rf"(?<!\w){re.escape(key)}(?!\w)", "", _last_line(self.failed[key]))


def _last_line(trace: str) -> str:
    return trace.strip().splitlines()[-1]


def _named(keys: Sequence[str]) -> str:
    """A stage's key, or how many there are and the first of them."""
    if len(keys) == 1:
        return keys[0]
    more = ", ..." if len(keys) > NAMED else ""
    return f"{len(keys)} stages ({', '.join(keys[:NAMED])}{more})"


class Scheduler:
    """Runs the stages of a plan, step by step; between two steps the plan may have grown.

    A step costs what has changed since the one before, and not what there is: a stage is looked for on disk when the
    plan gains it, when its turn has come, and while another sweep trains it.

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
        self.outcome = Outcome()
        self.elsewhere: set[str] = set()  # ready, and in training by another sweep
        self._ready = Ready(seconds or (lambda stage: float(stage.steps)))
        self._running: dict[str, Job] = {}
        self._ended: set[str] = set()  # not done, and not to be trained any further
        self._news: set[str] = set()
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

    def news(self) -> set[str]:
        """Stages of which something has become since this was asked last."""
        found, self._news = self._news, set()
        return found

    def is_idle(self, plan: Plan) -> bool:
        """Whether there is nothing to wait for; stages that it has not seen yet may be done, and then are news."""
        is_waiting = bool(self._running or self.elsewhere or self._wait_until)
        return not is_waiting and self._ready.has_seen(plan)

    def stop(self, keys: Iterable[str]) -> None:
        """End stages before their last epoch; what they have done stays."""
        for key in keys:
            if key not in self.outcome.done and key not in self._ended:
                self.outcome.stopped.append(key)
                self._end(key)

    def close(self) -> None:
        """End the running stages, and let go of the launcher."""
        for job in self._running.values():
            job.cancel()
        self.launcher.close()

    def _end(self, key: str) -> None:
        """Train a stage no further."""
        self._ended.add(key)
        self._news.add(key)
        job = self._running.pop(key, None)
        if job is not None:
            job.cancel()

    def _look(self, plan: Plan) -> None:
        """See which stages are done, of those that are new and of those that others train."""
        for key in self._ready.grow(plan):
            if not self._is_done_by_now(key) and self._is_ready(plan.stages[key]):
                self._ready.add(key)
        for key in self.elsewhere:
            if not self._is_done_by_now(key):
                self._ready.add(key)

    def _is_done_by_now(self, key: str) -> bool:
        """Whether a stage is done that this sweep has not trained."""
        if key not in self.outcome.done and self.layout.run(key).is_done:
            self.outcome.reused.append(key)
            self._done(key)
        return key in self.outcome.done

    def _done(self, key: str) -> None:
        self._tries.pop(key, None)
        self._newest.pop(key, None)
        self.outcome.done.add(key)
        self._news.add(key)
        self._add_children(key)

    def _add_children(self, key: str) -> None:
        for child in self._ready.children(key):
            self._ready.add(child)

    def _start_ready(self, plan: Plan) -> None:
        self.elsewhere = set()
        if len(self._running) >= self.launcher.slots or time.monotonic() < self._wait_until:
            return
        self._wait_until = 0.0
        for key in self._ready.drain():
            if not self._is_ready(plan.stages[key]) or self._is_done_by_now(key):
                continue
            if len(self._running) >= self.launcher.slots:
                self._ready.add(key)
                break
            if holder_of(self.layout.run(key).lease) is not None:
                self.elsewhere.add(key)  # it will be done, or its lease will end
            elif not self._launch(plan.stages[key]):
                self._ready.add(key)
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
        if self.launcher.has_queue:
            self._add_children(stage.key)
        return True

    def _count_try(self, folder: RunFolder) -> None:
        newest = max(folder.steps(), default=-1)
        if newest > self._newest.get(folder.key, -1):
            self._tries[folder.key] = 0  # it made progress since it was killed last
        self._newest[folder.key] = newest
        self._tries[folder.key] = self._tries.get(folder.key, 0) + 1

    def _is_ready(self, stage: Stage) -> bool:
        if stage.key in self._running or stage.key in self.outcome.done or stage.key in self._ended:
            return False
        if stage.parent is None or stage.parent in self.outcome.done:
            return True
        return self.launcher.has_queue and stage.parent in self._running

    def _collect(self, plan: Plan) -> None:
        for key, job in list(self._running.items()):
            state = job.state()
            if state.is_finished() and self._running.pop(key, None) is not None:
                self._take(plan, key, state)

    def _take(self, plan: Plan, key: str, state: JobState) -> None:
        """See what has become of a stage whose job has ended."""
        folder = self.layout.run(key)
        self._news.add(key)
        if folder.is_done:
            self.outcome.trained.append(key)
            self._done(key)
        elif self._parent_is_lost(plan, key) or holder_of(folder.lease) is not None:
            self._ready.add(key)  # or another sweep has taken it over
        elif state is not JobState.KILLED or self._tries[key] >= MAX_TRIES:
            self._fail(folder, state)
        else:
            self._ready.add(key)

    def _parent_is_lost(self, plan: Plan, key: str) -> bool:
        """Whether a stage could not start as its parent is not whole or has not ended; that is trained first."""
        parent = plan.stages[key].parent
        if parent is None or self.layout.run(parent).is_done:
            return False
        if parent not in self.outcome.done:
            return parent not in self._ended
        if self._tries[key] >= MAX_TRIES:
            return False
        self.outcome.done.discard(parent)
        self._ready.add(parent)
        return True

    def _fail(self, folder: RunFolder, state: JobState) -> None:
        self.outcome.failed[folder.key] = self._reason(folder, state)
        self._end(folder.key)
        for key in self._ready.descendants(folder.key):
            self.outcome.blocked.append(key)
            self._end(key)

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
