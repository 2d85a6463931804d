"""How far a sweep is: on a terminal a bar, elsewhere a line now and then; with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Iterable
from typing import Self

from tqdm import tqdm

from fl3d.core.leases import holder_of
from fl3d.core.records import Stage
from fl3d.core.streams import is_terminal
from fl3d.runs.layout import StoreFolder
from fl3d.runs.spec import steps_done
from fl3d.sweep.cost import Costs
from fl3d.sweep.makespan import makespan
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import Scheduler
from fl3d.sweep.tree import Apart

LINE_SECONDS = 30.0  # between lines where there is no terminal
BAR_SECONDS = 1.0  # between renewals of the bar where there is one
TRUST_SECONDS = 20.0  # of this run, before its own pace corrects the prediction
NAMED = 4  # stages that run now
SHARE = 0.02  # of a sweep's time goes to telling how far it is, at most


class Progress:
    """Shows the training steps done of all stages of a plan, the time left, and what a person should know at once.

    The time left is the length of the schedule of what remains. It is predicted from what stages of the same networks
    took, or from FLOPs, and corrected by the pace of this run.

    Args:
        title: of the bar.
        layout: of the store folder.
        costs: of stages.
        slots: stages at once.
    """

    def __init__(self, title: str, layout: StoreFolder, costs: Costs, slots: int) -> None:
        self.layout = layout
        self.costs = costs
        self.slots = slots
        self.lines = not is_terminal(sys.stderr)
        shape = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} steps [{elapsed}{postfix}]"
        self.bar = tqdm(
            total=0, desc=title, bar_format=shape, dynamic_ncols=True, disable=self.lines
        )
        self._next = time.monotonic() + self._pause
        self._ticked = time.monotonic()
        self._told: set[str] = set()
        self._failed: dict[str, str] = {}  # by why, the first stage that did
        self._slot_seconds = 0.0  # that were at work
        self._plan: Plan | None = None
        self._first: dict[str, float] = {}  # share done of stages that had begun when first seen
        self._shares: dict[str, float] = {}  # of each stage, now
        self._news: set[str] = set()  # stages that have changed since the bar was renewed

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    @property
    def _pause(self) -> float:
        return LINE_SECONDS if self.lines else BAR_SECONDS

    def show(self, plan: Plan, scheduler: Scheduler, news: Iterable[str]) -> None:
        """Renew the bar, and say what has failed or is in training elsewhere.

        Args:
            plan: of the sweep.
            scheduler: that runs it.
            news: stages that have changed since the last call.
        """
        self._tell(scheduler)
        self._news |= {*news, *scheduler.running, *scheduler.elsewhere}
        running = [plan.stages[key] for key in scheduler.running]
        now = time.monotonic()
        self._slot_seconds += (now - self._ticked) * len(running)
        self._ticked = now
        self._see(plan)
        if running and now >= self._next:
            self._renew(plan, running, scheduler.outcome.stopped)
            took = time.monotonic() - now
            self._next = now + max(self._pause, took / SHARE)

    def say(self, text: str) -> None:
        """Print a line without breaking the bar."""
        self.bar.write(text, file=sys.stderr)

    def _tell(self, scheduler: Scheduler) -> None:
        for key in scheduler.elsewhere - self._told:
            self._told.add(key)
            self.say(
                f"{key} is in training by {holder_of(self.layout.run(key).lease)}; waiting for it"
            )
        for key, trace in scheduler.outcome.failed.items():
            if key not in self._told:
                self._told.add(key)
                first = self._failed.setdefault(scheduler.outcome.kind(key), key)
                self.say(
                    f"\n{key} failed:\n{trace}" if first == key else f"{key} failed as {first} did"
                )

    def _see(self, plan: Plan) -> None:
        """Look at the stages that the plan has gained."""
        if plan is self._plan:
            return
        self._plan = plan
        self._apart = Apart(plan.stages.values())
        for key, stage in plan.stages.items():
            if key not in self._shares:
                self._shares[key] = self._share(stage)
                if self._shares[key]:
                    self._first[key] = self._shares[key]

    def _renew(self, plan: Plan, running: list[Stage], stopped: Collection[str]) -> None:
        self._see(plan)
        self._learn(plan)
        ended = set(stopped)
        stages = [stage for key, stage in plan.stages.items() if key not in ended]
        done = int(sum(self._shares[stage.key] * stage.steps for stage in stages))
        total = sum(stage.steps for stage in stages)
        names = ", ".join(self._name(stage) for stage in running[:NAMED])
        if len(running) > NAMED:
            names += f" and {len(running) - NAMED} more"
        known = all(self.costs.cost(stage).is_known for stage in stages)
        left = tqdm.format_interval(self.seconds_left(plan, ended)) if known else "?"
        if self.lines:
            print(f"{done}/{total} steps, {left} left: {names}", file=sys.stderr, flush=True)
        else:
            self.bar.total = total
            self.bar.n = done
            self.bar.set_postfix_str(f"{left} left: {names}")

    def _name(self, stage: Stage) -> str:
        """What to call a stage: its detector, name, and what sets it apart from others of that name."""
        label = self._apart.label(stage)
        return label if stage.parent is None else f"{stage.class_name} {label}"

    def _learn(self, plan: Plan) -> None:
        """Look again at the stages that have changed."""
        self.costs.learn(self._news)
        for key in self._news:
            self._shares[key] = self._share(plan.stages[key])
        self._news.clear()

    def seconds_left(self, plan: Plan, stopped: Collection[str] = ()) -> float:
        """Until the last stage ends."""
        left = {
            key: self.costs.cost(stage).seconds * (1 - self._shares[key])
            for key, stage in plan.stages.items()
            if self._shares[key] < 1 and key not in stopped
        }
        return makespan(plan, left, self.slots) * self._pace(plan)

    def _pace(self, plan: Plan) -> float:
        """Seconds that this run takes for a predicted second."""
        done = 0.0
        for key, stage in plan.stages.items():
            gained = self._shares[key] - self._first.get(key, 0.0)
            if gained:
                done += gained * self.costs.cost(stage).seconds
        if self._slot_seconds < TRUST_SECONDS or done <= 0:
            return 1.0
        return self._slot_seconds / done

    def _share(self, stage: Stage) -> float:
        """Of a stage's steps that are done."""
        return steps_done(self.layout.run(stage.key), stage) / stage.steps
