"""How far a sweep is: on a terminal a bar, elsewhere a line now and then; with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Mapping
from typing import Self

from tqdm import tqdm

from fl3d.core.leases import holder_of
from fl3d.core.records import Stage
from fl3d.core.streams import is_terminal
from fl3d.runs.layout import StoreFolder
from fl3d.runs.spec import steps_done
from fl3d.sweep.cost import Costs, makespan
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import Scheduler
from fl3d.sweep.tree import labels

LINE_SECONDS = 30.0  # between lines where there is no terminal
BAR_SECONDS = 1.0  # between renewals of the bar where there is one
TRUST_SECONDS = 20.0  # of this run, before its own pace corrects the prediction


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
        self._printed = time.monotonic()
        self._ticked = time.monotonic()
        self._told: set[str] = set()
        self._slot_seconds = 0.0  # that were at work
        self._first: dict[
            str, float
        ] = {}  # share of each stage that was done when it was first seen

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def show(self, plan: Plan, scheduler: Scheduler) -> None:
        """Renew the bar, and say what has failed or is in training elsewhere."""
        self._tell(scheduler)
        running = [plan.stages[key] for key in scheduler.running]
        now = time.monotonic()
        self._slot_seconds += (now - self._ticked) * len(running)
        self._ticked = now
        for key, stage in plan.stages.items():
            if key not in self._first:
                self._first[key] = self._share(stage)
        if running and now - self._printed >= (LINE_SECONDS if self.lines else BAR_SECONDS):
            self._printed = now
            self._renew(plan, running, scheduler.outcome.stopped)

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
                self.say(f"\n{key} failed:\n{trace}")

    def _renew(self, plan: Plan, running: list[Stage], stopped: Collection[str]) -> None:
        stages = [stage for key, stage in plan.stages.items() if key not in stopped]
        done = int(sum(steps_done(self.layout.run(stage.key), stage) for stage in stages))
        total = sum(stage.steps for stage in stages)
        names = ", ".join(running_labels(plan, running).values())
        self.costs.learn()
        known = all(self.costs.cost(stage).is_known for stage in stages)
        left = tqdm.format_interval(self.seconds_left(plan, stopped)) if known else "?"
        if self.lines:
            print(f"{done}/{total} steps, {left} left: {names}", file=sys.stderr, flush=True)
        else:
            self.bar.total = total
            self.bar.n = done
            self.bar.set_postfix_str(f"{left} left: {names}")

    def seconds_left(self, plan: Plan, stopped: Collection[str] = ()) -> float:
        """Until the last stage ends."""
        self.costs.learn()
        left = {}
        for key, stage in plan.stages.items():
            if key not in stopped and not self.layout.run(key).is_done:
                left[key] = self.costs.cost(stage).seconds * (1 - self._share(stage))
        return makespan(plan, left, self.slots) * self._pace(plan)

    def _pace(self, plan: Plan) -> float:
        """Seconds that this run takes for a predicted second."""
        done = 0.0
        for key, stage in plan.stages.items():
            share = self._share(stage)
            done += (share - self._first.get(key, share)) * self.costs.cost(stage).seconds
        if self._slot_seconds < TRUST_SECONDS or done <= 0:
            return 1.0
        return self._slot_seconds / done

    def _share(self, stage: Stage) -> float:
        """Of a stage's steps that are done."""
        return steps_done(self.layout.run(stage.key), stage) / stage.steps


def running_labels(plan: Plan, running: list[Stage]) -> Mapping[str, str]:
    """What to call stages that run: their detector, name, and what sets them apart from others of the same name."""
    wanted = {stage.name for stage in running}
    names = labels([stage for stage in plan.stages.values() if stage.name in wanted])
    found = {}
    for stage in running:
        name = names[stage.key]
        found[stage.key] = name if stage.parent is None else f"{stage.class_name} {name}"
    return found
