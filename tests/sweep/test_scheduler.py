"""Scheduling: order, failures, kills, and stages that others train."""

import json
import os
from contextlib import ExitStack
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
    assert outcome.failed == {"a": f"killed {MAX_TRIES} times since it last got on"}


def test_a_plan_may_grow_while_it_runs(tmp_path: Path) -> None:
    """As an Optuna study makes it: the last stage of one trial is what proposes the next."""
    scheduler = Scheduler(tree(stage("a", None)), {}, FakeLauncher(1), tmp_path)

    def grow(running: list[Stage]) -> None:
        names = sorted(scheduler.plan.stages)
        if scheduler.paths(names[-1]).done.exists() and len(names) < 4:
            scheduler.plan = scheduler.plan.joined(tree(stage("abcd"[len(names)], names[-1])))

    scheduler.on_tick = grow
    assert scheduler.run().trained == ["a", "b", "c", "d"]


def test_a_stopped_stage_is_ended_or_not_begun_and_no_failure(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.RUNNING]})
    scheduler = Scheduler(tree(stage("a", None), stage("b", None)), {}, launcher, tmp_path)

    def stop(running: list[Stage]) -> None:
        if running:
            scheduler.stop("a")
            scheduler.stop("b")

    scheduler.on_tick = stop
    outcome = scheduler.run()
    assert outcome.stopped == ["a", "b"]
    assert launcher.order == ["a"]
    assert launcher.jobs[0].cancelled
    outcome.check()


def test_a_stage_that_another_sweep_trains_is_waited_for(tmp_path: Path) -> None:
    launcher = FakeLauncher(2)
    scheduler = Scheduler(tree(stage("a", None), stage("a1", "a"), stage("b", None)), {}, launcher, tmp_path)
    ticks: list[list[str]] = []
    with ExitStack() as elsewhere:
        elsewhere.enter_context(leased(scheduler.paths("a").lease))

        def tick(running: list[Stage]) -> None:
            ticks.append(list(launcher.order))
            if len(ticks) == 20:  # the other sweep is through
                scheduler.paths("a").done.write_text("{}")
                elsewhere.close()

        scheduler.on_tick = tick
        outcome = scheduler.run()
    assert ticks[19] == ["b"]
    assert launcher.order == ["b", "a1"]
    assert outcome.reused == ["a"]


def test_what_another_sweep_leaves_undone_is_taken_over(tmp_path: Path) -> None:
    launcher = FakeLauncher(1)
    scheduler = Scheduler(tree(stage("a", None)), {}, launcher, tmp_path)
    with ExitStack() as elsewhere:
        elsewhere.enter_context(leased(scheduler.paths("a").lease))
        ticks: list[int] = []

        def tick(running: list[Stage]) -> None:
            ticks.append(len(launcher.order))
            if len(ticks) == 5:
                elsewhere.close()

        scheduler.on_tick = tick
        assert scheduler.run().trained == ["a"]
    assert ticks[:5] == [0] * 5


class QueueLauncher(FakeLauncher):
    """Takes children before their parents are done, as SLURM does."""

    has_queue = True

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        job = super().launch(folder)
        assert isinstance(job, FakeJob)
        job.after = after  # type: ignore[attr-defined]
        return job


def test_a_launcher_with_a_queue_gets_children_behind_their_parents(tmp_path: Path) -> None:
    launcher = QueueLauncher(9)
    scheduler = Scheduler(tree(stage("a", None), stage("a1", "a"), stage("a2", "a1")), {}, launcher, tmp_path)
    scheduler.run()
    assert launcher.order[:3] == ["a", "a1", "a2"]
    assert [job.after for job in launcher.jobs[:3]] == [None, *launcher.jobs[:2]]  # type: ignore[attr-defined]


def test_queued_children_of_a_stage_that_raised_are_taken_out(tmp_path: Path) -> None:
    launcher = QueueLauncher(9, {"a": [JobState.RAISED], "a1": [JobState.RUNNING], "a2": [JobState.RUNNING]})
    outcome = Scheduler(tree(stage("a", None), stage("a1", "a"), stage("a2", "a1")), {}, launcher, tmp_path).run()
    assert list(outcome.failed) == ["a"]
    assert outcome.blocked == ["a1", "a2"]
    assert launcher.order[:2] == ["a", "a1"]
    assert all(job.cancelled for job in launcher.jobs[1:])


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
