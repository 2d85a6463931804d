"""Scheduling: order, failures, kills, and stages that others train."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from fl3d.core.errors import StageFailed
from fl3d.core.leases import leased
from fl3d.core.records import Stage
from fl3d.evaluation.protocol import Protocol
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import Machine, read_spec
from fl3d.sweep.cost import Costs
from fl3d.sweep.launchers.base import Job, JobState, Launcher, LauncherBusy
from fl3d.sweep.plan import Plan
from fl3d.sweep.progress import Progress
from fl3d.sweep.scheduler import MAX_TRIES, Outcome, Scheduler
from fl3d.sweep.setup import machine
from tests.support import drive, small_sweep, train_stages

POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]
PROTOCOL = Protocol("test", "A", {"Car": (0.7, 0.7, 0.7)}, 0.5, 0.01, "standup", 10)
MACHINE = Machine(data_root=Path("data"), train_ids=("0",), val_ids=("1",), protocol=PROTOCOL)


def stage(key: str, parent: str | None, epochs: int = 1) -> Stage:
    return Stage(
        key=key,
        name=key,
        config={"loss": {}},
        parent=parent,
        start_epoch=0,
        start_step=0,
        epochs=epochs,
        epoch_steps=1,
    )


def tree(*stages: Stage) -> Plan:
    return Plan("test", (), {s.key: s for s in stages})


def schedule(launcher: Launcher, root: Path) -> Scheduler:
    return Scheduler(MACHINE, launcher, StoreFolder(root))


class FakeJob(Job):
    def __init__(self, folder: RunFolder, end: JobState) -> None:
        self.folder = folder
        self.end = end
        self.polls = 0
        self.cancelled = False
        self.after: Job | None = None

    def state(self) -> JobState:
        self.polls += 1
        if self.polls < 2:
            return JobState.RUNNING
        if self.end is JobState.DONE:
            self.folder.done.write_text("{}")
        if self.end is JobState.RAISED:
            self.folder.error.write_text("Traceback\nValueError: broken\n")
        return self.end

    def cancel(self) -> None:
        self.cancelled = True


class FakeLauncher(Launcher):
    """Ends each stage as told, and remembers the order."""

    def __init__(self, slots: int, ends: dict[str, list[JobState]] | None = None) -> None:
        self.slots = slots
        self.ends = ends or {}
        self.order: list[str] = []
        self.jobs: list[FakeJob] = []
        self.is_closed = False

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        self.order.append(folder.name)
        ends = self.ends.get(folder.name, [])
        job = FakeJob(RunFolder(folder), ends.pop(0) if ends else JobState.DONE)
        job.after = after
        self.jobs.append(job)
        return job

    def close(self) -> None:
        self.is_closed = True


def test_children_start_when_their_parent_is_done_longest_path_first(tmp_path: Path) -> None:
    plan = tree(stage("a", None), stage("a1", "a", 1), stage("b", None, 5), stage("b1", "b", 5))
    launcher = FakeLauncher(1)
    drive(schedule(launcher, tmp_path), plan)
    assert launcher.order == ["b", "b1", "a", "a1"]
    assert launcher.is_closed


def test_what_is_done_is_not_started(tmp_path: Path) -> None:
    plan = tree(stage("a", None), stage("a1", "a"))
    drive(schedule(FakeLauncher(2), tmp_path), plan)
    launcher = FakeLauncher(2)
    outcome = drive(schedule(launcher, tmp_path), plan)
    assert launcher.order == []
    assert outcome.reused == ["a", "a1"]
    assert outcome.done == {"a", "a1"}


def test_a_failure_stops_its_descendants_alone_and_is_known_at_once(tmp_path: Path) -> None:
    plan = tree(
        stage("a", None), stage("a1", "a"), stage("a2", "a1"), stage("b", None), stage("b1", "b")
    )
    launcher = FakeLauncher(1, {"a": [JobState.RAISED]})
    scheduler = schedule(launcher, tmp_path)
    known: list[list[str]] = []  # what had been started by the time the failure was known

    def tick(plan: Plan) -> Plan:
        if scheduler.outcome.failed:
            known.append(list(launcher.order))
        return plan

    outcome = drive(scheduler, plan, tick)
    assert known[0] == ["a", "b"]
    assert launcher.order == ["a", "b", "b1"]
    assert outcome.blocked == ["a1", "a2"]
    assert "ValueError: broken" in outcome.failed["a"]
    with pytest.raises(StageFailed, match="a: ValueError: broken"):
        outcome.check()


def test_stages_that_failed_alike_are_told_once() -> None:
    """Four have one message but for their names, and one has another."""
    alike = {f"s{i}": f"Traceback\n  line {i}\nValueError: see stages/s{i}/log\n" for i in range(4)}
    outcome = Outcome(failed={**alike, "t": "killed 3 times without making progress"})
    with pytest.raises(StageFailed) as error:
        outcome.check()
    assert str(error.value).splitlines() == [
        "5 stage(s) failed, 0 could not start:",
        "  4 stages (s0, s1, s2, ...): ValueError: see stages/s0/log",
        "  t: killed 3 times without making progress",
    ]


def test_a_sweep_tells_the_second_of_stages_that_fail_alike_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    launcher = FakeLauncher(2, {"a": [JobState.RAISED], "b": [JobState.RAISED]})
    scheduler = schedule(launcher, tmp_path)
    drive(scheduler, tree(stage("a", None), stage("b", None)))
    said: list[str] = []
    with Progress("x", scheduler.layout, Costs(scheduler.layout.stages, 1), 2) as progress:
        monkeypatch.setattr(progress, "say", said.append)
        progress.show(tree(), scheduler, ())
        progress.show(tree(), scheduler, ())
    assert len(said) == 2
    assert said[0].startswith("\na failed:\n")
    assert said[0].rstrip().endswith("ValueError: broken")
    assert said[1] == "b failed as a did"


def test_a_killed_stage_is_tried_again_a_raising_one_is_not(tmp_path: Path) -> None:
    ends = {
        "a": [JobState.KILLED, JobState.KILLED, JobState.DONE],
        "b": [JobState.RAISED],
    }
    launcher = FakeLauncher(1, ends)
    outcome = drive(schedule(launcher, tmp_path), tree(stage("a", None), stage("b", None)))
    assert launcher.order.count("a") == 3
    assert launcher.order.count("b") == 1
    assert outcome.trained == ["a"]


def test_a_stage_that_is_killed_every_time_fails_in_the_end(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.KILLED] * 9})
    outcome = drive(schedule(launcher, tmp_path), tree(stage("a", None)))
    assert launcher.order == ["a"] * MAX_TRIES
    assert outcome.failed == {"a": f"killed {MAX_TRIES} times without making progress"}


def test_a_stage_that_makes_progress_between_kills_may_be_killed_more_often(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.KILLED] * 9})
    scheduler = schedule(launcher, tmp_path)

    def tick(plan: Plan) -> Plan:
        marker = scheduler.layout.run("a").marker(len(launcher.order))
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.write_text("{}")
        return plan

    outcome = drive(scheduler, tree(stage("a", None)), tick)
    assert outcome.trained == ["a"]
    assert launcher.order == ["a"] * 10


def test_a_parent_that_is_not_whole_any_more_is_trained_again(tmp_path: Path) -> None:
    """A child whose parent's last checkpoint is torn takes the parent's marker away."""

    class Torn(FakeLauncher):
        def launch(self, folder: Path, after: Job | None = None) -> Job:
            if folder.name == "a1" and self.order.count("a1") == 0:
                folder.with_name("a").joinpath("done.json").unlink()
            return super().launch(folder, after)

    launcher = Torn(1, {"a1": [JobState.RAISED]})
    outcome = drive(schedule(launcher, tmp_path), tree(stage("a", None), stage("a1", "a")))
    assert launcher.order == ["a", "a1", "a", "a1"]
    assert not outcome.failed


def test_a_plan_may_grow_while_it_runs(tmp_path: Path) -> None:
    """As an Optuna study makes it: the last stage of one trial is what proposes the next."""
    scheduler = schedule(FakeLauncher(1), tmp_path)

    def grow(plan: Plan) -> Plan:
        names = sorted(plan.stages)
        if scheduler.layout.run(names[-1]).is_done and len(names) < 4:
            return plan.joined(tree(stage("abcd"[len(names)], names[-1])))
        return plan

    assert drive(scheduler, tree(stage("a", None)), grow).trained == ["a", "b", "c", "d"]


def test_what_a_plan_has_grown_by_may_be_done_already(tmp_path: Path) -> None:
    """It is seen before the loop ends, and told as reused."""
    drive(schedule(FakeLauncher(1), tmp_path), tree(stage("b", None)))
    scheduler = schedule(FakeLauncher(1), tmp_path)

    def grow(plan: Plan) -> Plan:
        return plan.joined(tree(stage("b", None))) if "a" in scheduler.outcome.done else plan

    outcome = drive(scheduler, tree(stage("a", None)), grow)
    assert outcome.trained == ["a"]
    assert outcome.reused == ["b"]


def test_a_stopped_stage_is_ended_or_not_begun_and_no_failure(tmp_path: Path) -> None:
    launcher = FakeLauncher(1, {"a": [JobState.RUNNING]})
    scheduler = schedule(launcher, tmp_path)

    def stop(plan: Plan) -> Plan:
        scheduler.stop(["a", "b"])
        return plan

    outcome = drive(scheduler, tree(stage("a", None), stage("b", None)), stop)
    assert outcome.stopped == ["a", "b"]
    assert launcher.order == ["a"]
    assert launcher.jobs[0].cancelled
    outcome.check()


def test_what_is_done_is_not_stopped(tmp_path: Path) -> None:
    scheduler = schedule(FakeLauncher(1), tmp_path)
    outcome = drive(scheduler, tree(stage("a", None)))
    scheduler.stop(["a"])
    assert outcome.stopped == []


def test_a_stage_that_another_sweep_trains_is_waited_for(tmp_path: Path) -> None:
    launcher = FakeLauncher(2)
    scheduler = schedule(launcher, tmp_path)
    folder = scheduler.layout.run("a")
    ticks: list[list[str]] = []
    with ExitStack() as elsewhere:
        elsewhere.enter_context(leased(folder.lease))

        def tick(plan: Plan) -> Plan:
            ticks.append(list(launcher.order))
            if len(ticks) == 20:  # the other sweep is through
                assert scheduler.elsewhere == {"a"}
                folder.done.write_text("{}")
                elsewhere.close()
            return plan

        plan = tree(stage("a", None), stage("a1", "a"), stage("b", None))
        outcome = drive(scheduler, plan, tick)
    assert ticks[19] == ["b"]
    assert launcher.order == ["b", "a1"]
    assert outcome.reused == ["a"]


def test_what_another_sweep_leaves_undone_is_taken_over(tmp_path: Path) -> None:
    launcher = FakeLauncher(1)
    scheduler = schedule(launcher, tmp_path)
    ticks: list[int] = []
    with ExitStack() as elsewhere:
        elsewhere.enter_context(leased(scheduler.layout.run("a").lease))

        def tick(plan: Plan) -> Plan:
            ticks.append(len(launcher.order))
            if len(ticks) == 5:
                elsewhere.close()
            return plan

        assert drive(scheduler, tree(stage("a", None)), tick).trained == ["a"]
    assert ticks[:5] == [0] * 5


class QueueLauncher(FakeLauncher):
    """Takes children before their parents are done, as SLURM does."""

    has_queue = True


def test_a_launcher_with_a_queue_gets_children_behind_their_parents(tmp_path: Path) -> None:
    launcher = QueueLauncher(9)
    plan = tree(stage("a", None), stage("a1", "a"), stage("a2", "a1"))
    drive(schedule(launcher, tmp_path), plan)
    assert launcher.order[:3] == ["a", "a1", "a2"]
    assert [job.after for job in launcher.jobs[:3]] == [None, *launcher.jobs[:2]]


def test_queued_children_of_a_stage_that_raised_are_taken_out(tmp_path: Path) -> None:
    ends = {
        "a": [JobState.RAISED],
        "a1": [JobState.RUNNING],
        "a2": [JobState.RUNNING],
    }
    launcher = QueueLauncher(9, ends)
    plan = tree(stage("a", None), stage("a1", "a"), stage("a2", "a1"))
    outcome = drive(schedule(launcher, tmp_path), plan)
    assert list(outcome.failed) == ["a"]
    assert outcome.blocked == ["a1", "a2"]
    assert launcher.order[:2] == ["a", "a1"]
    assert all(job.cancelled for job in launcher.jobs[1:])


class FullLauncher(FakeLauncher):
    """Refuses every second stage once, as a queue that is full."""

    def __init__(self, refusals: int) -> None:
        super().__init__(9)
        self.refusals = refusals

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        if self.refusals and self.order:
            self.refusals -= 1
            raise LauncherBusy("the queue is full")
        return super().launch(folder, after)


def test_a_launcher_that_refuses_a_stage_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where all that ran has ended before it is."""
    monkeypatch.setattr("fl3d.sweep.scheduler.BUSY_SECONDS", 0.05)
    launcher = FullLauncher(refusals=1)
    outcome = drive(schedule(launcher, tmp_path), tree(stage("a", None), stage("b", None)))
    assert outcome.trained == ["a", "b"]


def test_a_launcher_that_takes_nothing_at_all_is_an_error(tmp_path: Path) -> None:
    class Full(FakeLauncher):
        def launch(self, folder: Path, after: Job | None = None) -> Job:
            raise LauncherBusy("the queue is full")

    with pytest.raises(LauncherBusy):
        drive(schedule(Full(1), tmp_path), tree(stage("a", None)))


def test_an_interrupt_ends_the_running_stages(tmp_path: Path) -> None:
    launcher = FakeLauncher(2, {"a": [JobState.RUNNING], "b": [JobState.RUNNING]})

    def interrupt(plan: Plan) -> Plan:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(schedule(launcher, tmp_path), tree(stage("a", None), stage("b", None)), interrupt)
    assert [job.cancelled for job in launcher.jobs] == [True, True]
    assert launcher.is_closed


def test_a_stages_spec_is_frozen_in_its_folder(simulated: Path, tmp_path: Path) -> None:
    prepared = small_sweep(simulated, tmp_path, POINTS[:1])
    train_stages(prepared)
    for key, planned in prepared.plan.stages.items():
        spec = read_spec(prepared.layout.run(key))
        assert spec.stage == planned
        assert spec.machine == machine(prepared)
