"""What a plan costs, held against what is on disk: stages, time, FLOPs and disk."""

from __future__ import annotations

from tqdm import tqdm

from fl3d.core.leases import holder_of
from fl3d.core.plurals import several
from fl3d.core.records import Stage
from fl3d.runs.layout import StoreFolder
from fl3d.runs.retention import kept_epochs
from fl3d.runs.spec import steps_done
from fl3d.sweep.cost import Costs, checkpoint_epochs
from fl3d.sweep.makespan import makespan
from fl3d.sweep.plan import Plan


class Forecast:
    """A plan held against what is on disk.

    Args:
        plan: of the sweep.
        layout: of its store folder.
        n_val: validation frames.
        slots: stages at once.
        keep_every: epochs between checkpoints whose weights are kept; None: see ``retention``.
        has_keys: whether the data, and so the stages' keys, are known; else nothing is found done.
        is_example: whether the plan is one of trials that are not known yet: what is done of it says nothing of them.
    """

    def __init__(
        self,
        plan: Plan,
        layout: StoreFolder,
        n_val: int,
        slots: int,
        keep_every: int | None,
        has_keys: bool = True,
        is_example: bool = False,
    ) -> None:
        self.plan = plan
        self.slots = slots
        self.keep_every = keep_every
        self.has_keys = has_keys and not is_example
        self.is_example = is_example
        self.layout = layout
        costs = Costs(layout.stages, n_val)
        costs.learn()
        self.costs = {key: costs.cost(stage) for key, stage in plan.stages.items()}
        self.left = {key: 1 - self._share(stage) for key, stage in plan.stages.items()}
        self.todo = [key for key in plan.stages if is_example or not layout.run(key).is_done]

    def _share(self, stage: Stage) -> float:
        """Of a stage's steps that are done."""
        if self.is_example:
            return 0.0
        return steps_done(self.layout.run(stage.key), stage) / stage.steps

    def counts(self) -> str:
        """How many trials and stages there are, and how many of these are done."""
        n_stages = len(self.plan.stages)
        n_todo = len(self.todo)
        stages = f"{several(len(self.plan.trials), 'trial')} in {several(n_stages, 'stage')}"
        done = f"; {n_stages - n_todo} done" if self.has_keys else ""
        return f"{stages}{done}, {n_todo} to train"

    def summary(self) -> list[str]:
        """Lines of epochs, time, FLOPs and disk."""
        lines = [self._epochs()]
        if self.todo:
            lines.append(self._time())
        if any(self.costs[key].flops for key in self.todo):  # of a command neither is known
            lines += [self._work(), self._disk()]
        return lines

    def price(self, group: str, n_seeds: int) -> str:
        """What is still to be paid until a group has so many seeds: time and disk.

        Args:
            group: of the plan.
            n_seeds: at least those of the plan; a further one costs what one of these costs, from its first step on.
        """
        trials = [trial for trial in self.plan.trials if trial.group == group]
        stages = {key for trial in trials for key in trial.stages}
        planned = len({trial.seed for trial in trials})
        further = (n_seeds - planned) / planned
        whole = {key: self.costs[key].seconds for key in stages}
        todo = stages & set(self.todo)
        work = sum(whole[key] * self.left[key] for key in todo) + further * sum(whole.values())
        kept = sum(self._kept_bytes(key) for key in todo)
        kept += further * sum(self._kept_bytes(key) for key in stages)
        longest = max(sum(whole[key] for key in trial.stages) for trial in trials)
        if not all(self.costs[key].is_known for key in stages):
            return "for a time that is not known yet"
        seconds = max(work / self.slots, longest if further else 0.0)
        return f"{_span(seconds)} on {self.slots} at once, {_bytes(kept)} kept"

    def _epochs(self) -> str:
        todo = sum(self.plan.stages[key].epochs for key in self.todo)
        shared = f"{self.plan.epochs} of {self.plan.plain_epochs} without shared beginnings"
        return f"  epochs  {shared}{_by_detector(self.plan)}; {todo} to train"

    def _time(self) -> str:
        if not all(self.costs[key].is_known for key in self.todo):
            return "  time    not known until a command of this program has written results here"
        seconds = {key: self.costs[key].seconds * self.left[key] for key in self.todo}
        until = _span(makespan(self.plan, seconds, self.slots))
        work = _span(sum(seconds.values()))
        if all(self.costs[key].is_measured for key in self.todo):
            source = "from stages measured here"
        else:
            source = (
                "guessed from the layers' dense FLOPs, too short where other work counts, "
                "until a stage is measured"
            )
        return f"  time    {until} on {self.slots} at once, {work} of work ({source})"

    def _work(self) -> str:
        flops = sum(self.costs[key].flops * self.left[key] for key in self.todo)
        return f"  FLOPs   {flops:.2g} by dense layers, forward and backward"

    def _disk(self) -> str:
        written = sum(self.costs[key].bytes for key in self.todo)
        kept = sum(self._kept_bytes(key) for key in self.todo)
        return f"  disk    {_bytes(kept)} kept of {_bytes(written)} written"

    def _kept_bytes(self, key: str) -> float:
        """What is left of a stage after the retention rule; of detections all."""
        cost = self.costs[key]
        epochs = checkpoint_epochs(self.plan.stages[key])
        kept = len(kept_epochs(epochs, [], [self.keep_every])) + 1  # and the best, wherever it is
        return cost.weights_bytes * min(1.0, kept / len(epochs)) + cost.detection_bytes

    def note(self, stage: Stage) -> str:
        """What is known of a stage."""
        key = f"  [{stage.key}]" if self.has_keys else ""
        length = f"{several(stage.epochs, 'epoch')}, {several(stage.steps, 'step')}"
        return f"{length}, {self._state(stage)}{key}"

    def _state(self, stage: Stage) -> str:
        folder = self.layout.run(stage.key)
        if folder.is_done and not self.is_example:
            return "done"
        left = self.left[stage.key]
        holder = None if self.is_example else holder_of(folder.lease)
        if holder is not None:
            return f"in training by {holder}, {1 - left:.0%}"
        begun = f"{1 - left:.0%} done, " if left < 1 else ""
        if not self.costs[stage.key].is_known:
            return f"{begun}to train"
        return f"{begun}{_span(self.costs[stage.key].seconds * left)} to train"


def _span(seconds: float) -> str:
    """A time as people say it: ``1:05:00``, and from three days on ``12 days``."""
    days = seconds / 86400
    return f"{days:.0f} days" if days >= 3 else str(tqdm.format_interval(seconds))


def _by_detector(plan: Plan) -> str:
    """Epochs of each detector, where there are several."""
    shared: dict[str, int] = {}
    for stage in plan.stages.values():
        shared[stage.class_name] = shared.get(stage.class_name, 0) + stage.epochs
    plain = dict.fromkeys(shared, 0)
    for trial in plan.trials:
        for key in trial.stages:
            plain[plan.stages[key].class_name] += plan.stages[key].epochs
    if len(shared) < 2:
        return ""
    return f" ({', '.join(f'{name} {shared[name]} of {plain[name]}' for name in sorted(shared))})"


def _bytes(count: float) -> str:
    return str(tqdm.format_sizeof(count, "B", 1000))
