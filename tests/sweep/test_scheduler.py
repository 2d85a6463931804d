"""Scheduling: order, failures, kills, and stages that others train."""

import json
import os
from pathlib import Path

import pytest

from fl3d.errors import StageFailed, StoreError
from fl3d.leases import leased
from fl3d.records import Stage, StagePaths
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import MAX_TRIES, Scheduler
from tests.support import small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]


def stage(key: str, parent: str | None, epochs: int = 1) -> Stage:
    return Stage(key, key, {"loss": {}}, parent, 0, 0, epochs, 1)


def tree(*stages: Stage) -> Plan:
    return Plan("test", (), {s.key: s for s in stages})


class FakeJob(Job):
    def __init__(self, paths: StagePaths, end: JobState) -> None:
        self.paths, self.end, self.polls, self.cancelled = paths, end, 0, False

    def state(self) -> JobState:
        self.polls += 1
        if self.polls < 2:
            return JobState.RUNNING
        if self.end is JobState.DONE:
            self.paths.done.write_text("{}")
        if self.end is JobState.RAISED:
            self.paths.error.write_text("Traceback\nValueError: broken\n")
        return self.end

    def cancel(self) -> None:
        self.cancelled = True


class FakeLauncher(Launcher):
    """Ends each stage as told, and remembers the order."""

    def __init__(self, slots: int, ends: dict[str, list[JobState]] | None = None) -> None:
        self.slots, self.ends = slots, ends or {}
        self.order: list[str] = []
        self.most = 0
        self.jobs: list[FakeJob] = []

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        self.order.append(folder.name)
        ends = self.ends.get(folder.name, [])
        self.jobs.append(FakeJob(StagePaths(folder), ends.pop(0) if ends else JobState.DONE))
        return self.jobs[-1]


@pytest.fixture(autouse=True)
def _fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fl3d.sweep.scheduler.POLL_SECONDS", 0.0)


def test_children_start_when_their_parent_is_done_longest_path_first(tmp_path: Path) -> None:
    plan = tree(stage("a", None), stage("a1", "a", 1), stage("b", None, 5), stage("b1", "b", 5))
    launcher = FakeLauncher(1)
    Scheduler(plan, {}, launcher, tmp_path).run()
    assert launcher.order == ["b", "b1", "a", "a1"]


def test_what_is_done_is_not_started(tmp_path: Path) -> None:
    plan = tree(stage("a", None), stage("a1", "a"))
    Scheduler(plan, {}, FakeLauncher(2), tmp_path).run()
    launcher = FakeLauncher(2)
    outcome = Scheduler(plan, {}, launcher, tmp_path).run()
    assert launcher.order == []
    assert outcome.reused == ["a", "a1"]


def test_a_failure_stops_its_descendants_alone_and_is_told_at_once(tmp_path: Path) -> None:
    plan = tree(stage("a", None), stage("a1", "a"), stage("a2", "a1"), stage("b", None), stage("b1", "b"))
    told: list[tuple[str, str]] = []
    launcher = FakeLauncher(1, {"a": [JobState.RAISED]})
    scheduler = Scheduler(plan, {}, launcher, tmp_path, on_failure=lambda s, trace: told.append((s.key, trace)))
    outcome = scheduler.run()
    assert launcher.order == ["a", "b", "b1"]
    assert outcome.blocked == ["a1", "a2"]
    assert told[0][0] == "a"
    assert "ValueError: broken" in told[0][1]
    with pytest.raises(StageFailed, match="a: ValueError: broken"):
        outcome.check()


def test_a_killed_stage_is_tried_again_a_raising_one_is_not(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.KILLED, JobState.KILLED, JobState.DONE], "b": [JobState.RAISED]})
    outcome = Scheduler(tree(stage("a", None), stage("b", None)), {}, launcher, tmp_path).run()
    assert launcher.order.count("a") == 3
    assert launcher.order.count("b") == 1
    assert outcome.trained == ["a"]


def test_a_stage_that_is_killed_every_time_fails_in_the_end(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.KILLED] * 9})
    outcome = Scheduler(tree(stage("a", None)), {}, launcher, tmp_path).run()
    assert launcher.order == ["a"] * MAX_TRIES
    assert outcome.failed == {"a": f"killed {MAX_TRIES} times"}


def test_an_interrupt_ends_the_running_stages(tmp_path: Path) -> None:
    launcher = FakeLauncher(2, {"a": [JobState.RUNNING], "b": [JobState.RUNNING]})

    def interrupt(running: list[Stage]) -> None:
        if running:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Scheduler(tree(stage("a", None), stage("b", None)), {}, launcher, tmp_path, on_tick=interrupt).run()
    assert [job.cancelled for job in launcher.jobs] == [True, True]


def test_local_stages_may_have_loader_workers(simulated: Path, tmp_path: Path) -> None:
    from fl3d.sweep.launchers.local import LocalLauncher

    outcome = small_sweep(simulated, tmp_path, POINTS[:1], "workers=1").run(LocalLauncher(1))
    assert len(outcome.trained) == 2


def test_the_same_sweep_is_not_started_twice(simulated: Path, tmp_path: Path) -> None:
    from fl3d.sweep.launchers.inline import InlineLauncher

    sweep = small_sweep(simulated, tmp_path, POINTS[:1])
    with (
        leased(sweep.names.plan(sweep.root).with_suffix(".lease")),
        pytest.raises(StoreError, match=f"in use by process {os.getpid()}"),
    ):
        sweep.run(InlineLauncher())


def test_a_stages_spec_is_frozen_in_its_folder(simulated: Path, tmp_path: Path) -> None:
    from fl3d.sweep.launchers.inline import InlineLauncher

    sweep = small_sweep(simulated, tmp_path, POINTS[:1])
    sweep.run(InlineLauncher())
    for key, planned in sweep.plan.stages.items():
        spec = json.loads(StagePaths(sweep.stages_root / key).spec.read_text())
        assert Stage(**spec["stage"]) == planned
