"""How far a sweep is: on a terminal a bar, elsewhere a line now and then; with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Self

from tqdm import tqdm

from fl3d.records import Stage, StagePaths
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import steps_done

LINE_SECONDS = 30  # between lines where there is no terminal


class Progress:
    """Shows the training steps done of all stages of a plan.

    Args:
        plan: what runs.
        paths: files of a stage.
    """

    def __init__(self, plan: Plan, paths: Callable[[str], StagePaths]) -> None:
        self.plan, self.paths = plan, paths
        total = sum(stage.steps for stage in plan.stages.values())
        done = sum(steps_done(paths(key), stage) for key, stage in plan.stages.items())
        self.lines = not sys.stderr.isatty()
        self.bar = tqdm(
            total=total, initial=done, desc=plan.sweep, unit="step", dynamic_ncols=True, smoothing=0, disable=self.lines
        )
        self.started = self.printed = time.monotonic()
        self.first, self.done, self.total = done, done, total

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def tick(self, running: list[Stage]) -> None:
        """Renew the bar."""
        self.done = sum(steps_done(self.paths(key), stage) for key, stage in self.plan.stages.items())
        names = ", ".join(f"{s.key.rsplit('-', 1)[0]} γ={s.config['loss'].get('gamma', 0):g}" for s in running)
        self.bar.set_postfix_str(names, refresh=False)
        self.bar.update(self.done - self.bar.n)
        now = time.monotonic()
        if self.lines and running and now - self.printed > LINE_SECONDS:
            self.printed = now
            print(f"{self.done}/{self.total} steps, {self._left(now)} left: {names}", file=sys.stderr, flush=True)

    def _left(self, now: float) -> str:
        new = self.done - self.first
        if not new:
            return "unknown time"
        seconds = (self.total - self.done) * (now - self.started) / new
        return tqdm.format_interval(seconds)

    def say(self, text: str) -> None:
        """Print a line without breaking the bar."""
        self.bar.write(text, file=sys.stderr)
