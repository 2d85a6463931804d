"""Run a sweep: the loop from what a sweeper proposes to a store that holds every score.

Read this first. Nothing here trains: stages do, wherever the launcher starts them. What the loop needs is made in
``setup``; between two turns of it, everything that may change is a value in a local variable.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass

from fl3d.core import interrupts
from fl3d.core.leases import Lease, leased
from fl3d.runs.retention import Tidy
from fl3d.store.base import Store
from fl3d.store.opening import open_store
from fl3d.sweep.checked import check_start
from fl3d.sweep.cost import Costs
from fl3d.sweep.evidence import Disk
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.notes import announcement
from fl3d.sweep.plan import Plan
from fl3d.sweep.progress import Progress
from fl3d.sweep.recorder import Recorder
from fl3d.sweep.recording import Recording
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.setup import (
    Frozen,
    Prepared,
    left_out,
    looks_kept,
    machine,
    refuse_several_machines,
    scoreboard,
    subject,
)
from fl3d.sweep.standings import Standings, no_curve
from fl3d.sweep.sweepers.base import Standing

POLL_SECONDS = 0.2  # a stage takes minutes; this is a five hundredth of a tiny one


@dataclass(frozen=True, kw_only=True)
class Ran:
    """What a sweep has come to.

    Args:
        plan: as it has grown.
        outcome: what became of its stages.
        standings: how its trials stand.
        recorder: what wrote them to the store.
    """

    plan: Plan
    outcome: Outcome
    standings: Mapping[str, Standing]
    recorder: Recorder


def run_sweep(
    prepared: Prepared,
    launcher: Launcher,
    store: Store | None = None,
    say: Callable[[str], None] = print,
) -> Ran:
    """Train what is missing, and log every score.

    Args:
        prepared: the sweep.
        launcher: where its stages run.
        store: for its scores; None: the one that its config names.
        say: prints a line for the user.

    Raises:
        StoreError: another process is running this sweep on this store, or the store cannot be reached.
    """
    settings = prepared.settings
    layout = prepared.layout
    store = store or open_store(settings.store.root, settings.store.uri)
    launcher.open()
    with leased(layout.lease(settings.experiment), wait=False) as lease:
        refuse_several_machines(store, layout)
        store.open()
        check_start(prepared, say)
        for remark in (left_out(prepared), looks_kept(prepared)):
            if remark:
                say(remark)
        frozen = Frozen(prepared)
        frozen.keep(prepared.plan)
        prepared.sweeper.open(prepared.planner.key)
        scores = scoreboard(prepared)
        costs = Costs(layout.stages, len(prepared.data.val_ids))
        scheduler = Scheduler(machine(prepared), launcher, layout, costs.seconds)
        say(announcement(settings, prepared.plan, layout, launcher.slots))
        with Progress(settings.experiment, layout, costs, launcher.slots) as progress:
            recorder = Recorder(store, scores, subject(prepared, store, scores), progress.say)
            recording = Recording(recorder)
            prepared.sweeper.consult(Disk(prepared, costs, progress.say))
            try:
                with closing(scheduler):  # its stages end first: the store may not answer
                    return _loop(prepared, frozen, scheduler, recording, scores, progress, lease)
            except BaseException:
                recording.interrupt()
                raise


def _loop(
    prepared: Prepared,
    frozen: Frozen,
    scheduler: Scheduler,
    recording: Recording,
    scores: Scoreboard,
    progress: Progress,
    lease: Lease,
) -> Ran:
    """The loop itself, until nothing runs and nothing is left to start; a turn costs what has changed since."""
    sweeper = prepared.sweeper
    plan = prepared.plan
    standings = Standings(scores.curve if sweeper.listens else no_curve)
    tidy = Tidy(prepared.layout, prepared.settings.store.keep_every)
    done: set[str] = set()  # stages whose weights may be tidied once they are recorded
    while True:
        interrupts.check()
        lease.check()
        scheduler.step(plan)  # collect what ended, start what is ready
        news = scheduler.news() | scores.changed({*scheduler.running, *scheduler.elsewhere})
        recording.offer(standings.update(plan, scheduler.outcome, news))
        done |= news & scheduler.outcome.done
        if recording.is_idle:
            tidy.stages(done)
            done.clear()
        advice = sweeper.advise(standings, scheduler.launcher.slots)
        if advice.points:
            plan = prepared.planner.plan(advice.points, plan)
            frozen.keep(plan)
        scheduler.stop(advice.stop)
        progress.show(plan, scheduler, news)
        if scheduler.is_idle(plan):
            break
        time.sleep(POLL_SECONDS)
    standings.update(plan, scheduler.outcome, scheduler.news())  # what was stopped last
    recording.offer(standings)
    recording.finish()
    tidy.stages(scheduler.outcome.done)
    return Ran(
        plan=plan, outcome=scheduler.outcome, standings=standings, recorder=recording.recorder
    )
