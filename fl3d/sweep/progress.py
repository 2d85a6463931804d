"""A bar for the whole sweep, with the stages that run now and the time left."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Self

from tqdm import tqdm

from fl3d.records import Stage, StagePaths
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import steps_done


class Progress:
    """Shows training steps done of all stages of a plan; on a terminal a bar, elsewhere a line now and then.

    Args:
        plan: what runs.
        paths: files of a stage.
    """

    def __init__(self, plan: Plan, paths: Callable[[str], StagePaths]) -> None:
        self.plan, self.paths = plan, paths
        total = sum(stage.steps for stage in plan.stages.values())
        done = sum(steps_done(paths(key), stage) for key, stage in plan.stages.items())
        interactive = sys.stderr.isatty()
        self.bar = tqdm(
            total=total,
            initial=done,
            desc=plan.sweep,
            unit="step",
            dynamic_ncols=interactive,
            ncols=None if interactive else 120,
            mininterval=0.5 if interactive else 15,
            smoothing=0.02,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def tick(self, running: list[Stage]) -> None:
        """Renew the bar."""
        done = sum(steps_done(self.paths(key), stage) for key, stage in self.plan.stages.items())
        names = ", ".join(f"{s.key.rsplit('-', 1)[0]} γ={s.config['loss'].get('gamma', 0):g}" for s in running)
        self.bar.set_postfix_str(names, refresh=False)
        self.bar.update(done - self.bar.n)

    def say(self, text: str) -> None:
        """Print a line without breaking the bar."""
        self.bar.write(text, file=sys.stderr)
