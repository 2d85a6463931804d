"""What a sweeper may look up while its sweep runs: verdicts and work, read from disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import pandas as pd

from fl3d.analysis.judge import Judge
from fl3d.analysis.seed_cost import work_seconds
from fl3d.core.errors import CheckpointError
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import steps_done
from fl3d.runs.trials import FinishedTrial
from fl3d.sweep.cost import Costs
from fl3d.sweep.makespan import makespan
from fl3d.sweep.plan import Plan
from fl3d.sweep.setup import Prepared
from fl3d.sweep.sweepers.base import Evidence, Point, Standing, TrialState, Work


class Disk(Evidence):
    """Evidence of what trials have left in the store folder; the store itself is not asked.

    Args:
        prepared: the sweep.
        costs: of stages.
        say: prints a line for the user.
    """

    def __init__(self, prepared: Prepared, costs: Costs, say: Callable[[str], None]) -> None:
        self._prepared = prepared
        self._costs = costs
        self._say = say
        self._judge = Judge(say)
        self.factor = prepared.planner.design.factor
        self.margin = prepared.settings.sweep.margin
        self.looks_before = prepared.looks_before

    def say(self, text: str) -> None:
        """Print a line for the user."""
        self._say(text)

    def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
        """See ``Evidence``; what was looked at before is not read again."""
        return self._judge.verdicts(self._finished(standings))

    def _finished(self, standings: Mapping[str, Standing]) -> FinishedSweep:
        """The sweep as it is opened later, without its scores: judging needs detections alone."""
        prepared = self._prepared
        trials = tuple(one.trial for one in standings.values())
        plan = prepared.planner.frozen(Plan(prepared.settings.experiment, trials, {}))
        done = [
            FinishedTrial(trial, tuple(prepared.layout.run(key) for key in trial.stages))
            for trial in plan.trials
            if standings[trial.key].state is TrialState.DONE
        ]
        return FinishedSweep(
            settings=prepared.settings,
            plan=plan,
            trials=tuple(done),
            scores=pd.DataFrame(),
            source=prepared.settings.store.root,
        )

    def work(self, standings: Mapping[str, Standing], points: Sequence[Point], slots: int) -> Work:
        """See ``Evidence``; done is what checkpoints say that they took, left is what ``plan`` would say."""
        self._costs.learn()
        layout = self._prepared.layout
        plan = self._prepared.planner.plan(points)
        keys = {key for one in standings.values() for key in one.trial.stages} | set(plan.stages)
        done = 0.0
        for key in sorted(keys):
            with suppress(CheckpointError):  # it is trained again, or its trial is left out
                done += work_seconds(layout.run(key))
        left = {}
        for key, stage in plan.stages.items():
            folder = layout.run(key)
            if not folder.is_done:
                share = steps_done(folder, stage) / stage.steps
                left[key] = self._costs.seconds(stage) * (1 - share)
        return Work(done, sum(left.values()), makespan(plan, left, slots))
