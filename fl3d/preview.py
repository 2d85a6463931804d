"""What a sweep would do, before it does it: stages, what is done, epochs, time, FLOPs and disk. Nothing is trained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tqdm import tqdm

from fl3d.config import Multirun, build
from fl3d.data.prepare import is_prepared, prepare_data
from fl3d.leases import holder_of
from fl3d.records import Stage, StagePaths
from fl3d.sweep.cost import Costs, checkpoint_epochs, makespan
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.scheduler import steps_done
from fl3d.sweep.sweepers.base import Point, Sweeper
from fl3d.sweep.tree import plan_tree

NOT_YET = "not simulated yet"  # stands for the digest of data that would be simulated first


def preview(multirun: Multirun, say: Callable[[str], None] = print) -> Plan:
    """Print the plan of a sweep.

    Args:
        multirun: what the command line says.
        say: prints a line for the user.

    Returns:
        the plan; of a study, that of one of its trials.

    Raises:
        ConfigError: the sweep cannot be run.
        DataError: the data cannot be used.
    """
    sweeper: Sweeper = build(multirun.sweeper, "hydra.sweeper").proposer(multirun.arguments, multirun.compose)
    launcher: Launcher = build(multirun.launcher, "hydra.launcher")
    info, n_val = _data(sweeper)
    planner = Planner(sweeper.base, info)
    points = sweeper.first()
    plan = planner.plan(points or [Point((), sweeper.base)])
    view = _View(plan, Path(sweeper.base["store"]["root"]) / "stages", n_val)
    say(f"{planner.name}: {view.head()}" + ("" if info.digest != NOT_YET else f" (data: {NOT_YET})"))
    if points:
        say(view.summary(launcher.slots, sweeper.base["store"]["keep_every"]))
    else:
        say(f"A study of {sweeper.n_trials} trials, proposed one by one. One of them, with nothing shared:")
        say(view.summary(1, sweeper.base["store"]["keep_every"]))
    say("")
    for line in plan_tree(plan, view.note):
        say(line)
    return plan


def _data(sweeper: Sweeper) -> tuple[DataInfo, int]:
    section = sweeper.base["data"]
    if not is_prepared(section):
        return DataInfo(NOT_YET, section["train_frames"], NOT_YET), section["val_frames"]
    data = prepare_data(section)
    return DataInfo(data.digest, len(data.train_ids), data.image_digest), len(data.val_ids)


class _View:
    """A plan held against what is on disk."""

    def __init__(self, plan: Plan, stages_root: Path, n_val: int) -> None:
        self.plan, self.stages_root = plan, stages_root
        costs = Costs(stages_root, n_val)
        costs.learn()
        self.costs = {key: costs.cost(stage) for key, stage in plan.stages.items()}
        self.left = {key: 1 - steps_done(self.paths(key), stage) / stage.steps for key, stage in plan.stages.items()}

    def paths(self, key: str) -> StagePaths:
        return StagePaths(self.stages_root / key)

    def todo(self) -> list[str]:
        return [key for key in self.plan.stages if not self.paths(key).done.exists()]

    def head(self) -> str:
        todo = len(self.todo())
        done = len(self.plan.stages) - todo
        return f"{len(self.plan.trials)} trials in {len(self.plan.stages)} stages; {done} done, {todo} to train"

    def summary(self, slots: int, keep_every: int | None) -> str:
        todo = self.todo()
        epochs = sum(self.plan.stages[key].epochs for key in todo)
        seconds = {key: self.costs[key].seconds * self.left[key] for key in todo}
        flops = sum(self.costs[key].flops * self.left[key] for key in todo)
        measured = all(self.costs[key].is_measured for key in todo)
        guess = "guessed from the layers' dense FLOPs, too short where other work counts, until a stage is measured"
        source = "from stages measured here" if measured else guess
        while_on, kept = sum(self.costs[key].bytes for key in todo), self._kept(todo, keep_every)
        detectors = _by_detector(self.plan)
        lines = [f"  epochs  {self.plan.epochs} of {self.plan.plain_epochs} without shared beginnings{detectors}"]
        lines[0] += f"; {epochs} to train"
        if todo:
            time = tqdm.format_interval(makespan(self.plan, seconds, slots))
            work = tqdm.format_interval(sum(seconds.values()))
            lines.append(f"  time    {time} on {slots} at once, {work} of work ({source})")
            lines.append(f"  FLOPs   {flops:.2g} by dense layers, forward and backward")
            lines.append(f"  disk    {_bytes(kept)} kept of {_bytes(while_on)} written")
        return "\n".join(lines)

    def _kept(self, todo: Sequence[str], every: int | None) -> float:
        """Bytes after the retention rule; detections are all kept, and counted with their share of the whole."""
        total = 0.0
        for key in todo:
            stage = self.plan.stages[key]
            epochs = checkpoint_epochs(stage)
            kept = {epochs[-1]} | {epoch for epoch in epochs if every and epoch % every == 0}
            share = min(1.0, (len(kept) + 1) / len(epochs))  # and the best, wherever it is
            total += self.costs[key].weights_bytes * share + self.costs[key].detection_bytes
        return total

    def note(self, stage: Stage) -> str:
        """What is known of a stage."""
        cost, paths = self.costs[stage.key], self.paths(stage.key)
        if paths.done.exists():
            state = "done"
        elif (holder := holder_of(paths.lease)) is not None:
            state = f"in training by {holder}, {1 - self.left[stage.key]:.0%}"
        else:
            begun = 1 - self.left[stage.key]
            state = (
                f"{begun:.0%} done, " if begun else ""
            ) + f"{tqdm.format_interval(cost.seconds * (1 - begun))} to train"
        return f"{stage.epochs} epochs, {stage.steps} steps, {state}  [{stage.key}]"


def _by_detector(plan: Plan) -> str:
    """Epochs of each detector, where there are several."""
    targets = {stage.config["detector"]["_target_"] for stage in plan.stages.values()}
    if len(targets) < 2:
        return ""
    parts = []
    for target in sorted(targets):
        own = {key: s.epochs for key, s in plan.stages.items() if s.config["detector"]["_target_"] == target}
        plain = sum(own[key] for trial in plan.trials for key in trial.stages if key in own)
        parts.append(f"{target.rsplit('.', 1)[-1]} {sum(own.values())} of {plain}")
    return f" ({', '.join(parts)})"


def _bytes(count: float) -> str:
    return f"{tqdm.format_sizeof(count, 'B', 1000)}"
