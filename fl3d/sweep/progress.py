"""How far a sweep is: on a terminal a bar, elsewhere a line now and then; with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Self

from tqdm import tqdm

from fl3d.records import Stage, StagePaths
from fl3d.sweep.cost import Costs, makespan
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import steps_done

LINE_SECONDS = 30.0  # between lines where there is no terminal
BAR_SECONDS = 1.0  # between renewals of the bar where there is one
TRUST_SECONDS = 20.0  # of this run, before its own pace corrects the prediction


class Progress:
    """Shows the training steps done of all stages of a plan, and the time left.

    The time left is the length of the schedule of what remains. It is predicted from what stages of the same networks
    took, or from FLOPs, and corrected by the pace of this run.

    Args:
        plan: what runs; may grow.
        paths: files of a stage.
        costs: of stages.
        slots: stages at once.
    """

    def __init__(self, plan: Plan, paths: Callable[[str], StagePaths], costs: Costs, slots: int) -> None:
        self.plan, self.paths, self.costs, self.slots = plan, paths, costs, slots
        self.lines = not sys.stderr.isatty()
        shape = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} steps [{elapsed}{postfix}]"
        self.bar = tqdm(total=0, desc=plan.sweep, bar_format=shape, dynamic_ncols=True, disable=self.lines)
        self.started = self.printed = self.ticked = time.monotonic()
        self.stopped: set[str] = set()
        self._slot_seconds = 0.0  # that were at work
        self._first = {key: self._share(key) for key in plan.stages}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def tick(self, running: list[Stage]) -> None:
        """Renew the bar.

        Args:
            running: stages that run now.
        """
        now = time.monotonic()
        self._slot_seconds += (now - self.ticked) * len(running)
        self.ticked = now
        if not running or now - self.printed < (LINE_SECONDS if self.lines else BAR_SECONDS):
            return
        self.printed = now
        stages = [stage for key, stage in self.plan.stages.items() if key not in self.stopped]
        done, total = sum(steps_done(self.paths(s.key), s) for s in stages), sum(s.steps for s in stages)
        names = ", ".join(_label(stage) for stage in running)
        left = tqdm.format_interval(self.seconds_left())
        if self.lines:
            print(f"{done}/{total} steps, {left} left: {names}", file=sys.stderr, flush=True)
        else:
            self.bar.total, self.bar.n = total, done
            self.bar.set_postfix_str(f"{left} left: {names}")

    def seconds_left(self) -> float:
        """Until the last stage ends."""
        self.costs.learn()
        left = {}
        for key, stage in self.plan.stages.items():
            if key not in self.stopped and not self.paths(key).done.exists():
                left[key] = self.costs.cost(stage).seconds * (1 - self._share(key))
        return makespan(self.plan, left, self.slots) * self._pace()

    def _pace(self) -> float:
        """Seconds that this run takes for a predicted second."""
        done = 0.0
        for key, stage in self.plan.stages.items():
            share = self._share(key)
            done += (share - self._first.setdefault(key, share)) * self.costs.cost(stage).seconds
        if self._slot_seconds < TRUST_SECONDS or done <= 0:
            return 1.0
        return self._slot_seconds / done

    def _share(self, key: str) -> float:
        """Of a stage's steps that are done."""
        stage = self.plan.stages[key]
        return steps_done(self.paths(key), stage) / stage.steps

    def say(self, text: str) -> None:
        """Print a line without breaking the bar."""
        self.bar.write(text, file=sys.stderr)


def _label(stage: Stage) -> str:
    return f"{stage.key.rsplit('-', 1)[0]} γ={stage.config['loss'].get('gamma', 0):g}"
