"""What a sweep would do, before it does it: stages, time, FLOPs and disk. Nothing is trained."""

from __future__ import annotations

from collections.abc import Callable

from tqdm import tqdm

from fl3d.config.settings import DataSettings, read_settings
from fl3d.core.errors import ConfigError
from fl3d.core.leases import holder_of
from fl3d.core.records import Stage
from fl3d.runs.layout import StoreFolder
from fl3d.runs.retention import kept_epochs
from fl3d.runs.spec import steps_done
from fl3d.sweep.cost import Costs, checkpoint_epochs, makespan
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.prepare import is_prepared, prepare_data
from fl3d.sweep.sweepers.base import Point, Sweeper
from fl3d.sweep.tree import plan_tree

NOT_YET = "not simulated yet"  # stands for the digest of data that would be simulated first


def preview(sweeper: Sweeper, launcher: Launcher, say: Callable[[str], None] = print) -> Plan:
    """Print the plan of a sweep.

    Args:
        sweeper: proposes its trials.
        launcher: where its stages would run.
        say: prints a line for the user.

    Returns:
        the plan; of a study, that of one of its trials.

    Raises:
        ConfigError: the sweep cannot be run.
        DataError: the data cannot be used.
    """
    if not sweeper.base:
        raise ConfigError("a sweep needs at least one trial")
    settings = read_settings(sweeper.base)
    data, n_val = _frames(settings.data)
    points = sweeper.first()
    swept = sweeper.swept if points else ()  # a study's one trial has no values of its own
    planner = Planner(sweeper.base, settings, swept, data)
    plan = planner.plan(points or [Point((), {}, sweeper.base)])
    if points:
        planner.frozen(plan)  # refuses a baseline that is none of the levels
    forecast = Forecast(plan, StoreFolder(settings.store.root), n_val)
    unready = f" (data: {NOT_YET})" if data.digest == NOT_YET else ""
    say(f"{settings.experiment}: {forecast.counts()}{unready}")
    slots = launcher.slots
    if not points:
        slots = 1
        count = sweeper.n_trials
        say(f"A study of {count} trials, proposed one by one. One of them, with nothing shared:")
    for line in forecast.summary(slots, settings.store.keep_every):
        say(line)
    say("")
    for line in plan_tree(plan, forecast.note):
        say(line)
    return plan


def _frames(data: DataSettings) -> tuple[DataInfo, int]:
    """Identity of the frames, and how many are for validation; nothing is simulated for it."""
    n_train = data.train_frames
    n_val = data.val_frames
    if n_train is None or n_val is None or is_prepared(data):
        prepared = prepare_data(data)
        info = DataInfo(prepared.digest, len(prepared.train_ids), prepared.image_digest)
        return info, len(prepared.val_ids)
    return DataInfo(NOT_YET, n_train, NOT_YET), n_val


class Forecast:
    """A plan held against what is on disk.

    Args:
        plan: of the sweep.
        layout: of its store folder.
        n_val: validation frames.
    """

    def __init__(self, plan: Plan, layout: StoreFolder, n_val: int) -> None:
        self.plan = plan
        self.layout = layout
        costs = Costs(layout.stages, n_val)
        costs.learn()
        self.costs = {key: costs.cost(stage) for key, stage in plan.stages.items()}
        self.left = {key: 1 - self._share(stage) for key, stage in plan.stages.items()}
        self.todo = [key for key in plan.stages if not layout.run(key).is_done]

    def _share(self, stage: Stage) -> float:
        """Of a stage's steps that are done."""
        return steps_done(self.layout.run(stage.key), stage) / stage.steps

    def counts(self) -> str:
        """How many trials and stages there are, and how many of these are done."""
        n_stages = len(self.plan.stages)
        n_todo = len(self.todo)
        stages = f"{len(self.plan.trials)} trials in {n_stages} stages"
        return f"{stages}; {n_stages - n_todo} done, {n_todo} to train"

    def summary(self, slots: int, keep_every: int | None) -> list[str]:
        """Lines of epochs, time, FLOPs and disk.

        Args:
            slots: stages at once.
            keep_every: epochs between checkpoints whose weights are kept; None: see ``retention``.
        """
        lines = [self._epochs()]
        if self.todo:
            lines += [self._time(slots), self._work(), self._disk(keep_every)]
        return lines

    def _epochs(self) -> str:
        todo = sum(self.plan.stages[key].epochs for key in self.todo)
        shared = f"{self.plan.epochs} of {self.plan.plain_epochs} without shared beginnings"
        return f"  epochs  {shared}{_by_detector(self.plan)}; {todo} to train"

    def _time(self, slots: int) -> str:
        seconds = {key: self.costs[key].seconds * self.left[key] for key in self.todo}
        until = tqdm.format_interval(makespan(self.plan, seconds, slots))
        work = tqdm.format_interval(sum(seconds.values()))
        if all(self.costs[key].is_measured for key in self.todo):
            source = "from stages measured here"
        else:
            source = (
                "guessed from the layers' dense FLOPs, too short where other work counts, "
                "until a stage is measured"
            )
        return f"  time    {until} on {slots} at once, {work} of work ({source})"

    def _work(self) -> str:
        flops = sum(self.costs[key].flops * self.left[key] for key in self.todo)
        return f"  FLOPs   {flops:.2g} by dense layers, forward and backward"

    def _disk(self, keep_every: int | None) -> str:
        written = sum(self.costs[key].bytes for key in self.todo)
        kept = sum(self._kept_bytes(key, keep_every) for key in self.todo)
        return f"  disk    {_bytes(kept)} kept of {_bytes(written)} written"

    def _kept_bytes(self, key: str, keep_every: int | None) -> float:
        """What is left of a stage after the retention rule; of detections all."""
        cost = self.costs[key]
        epochs = checkpoint_epochs(self.plan.stages[key])
        kept = len(kept_epochs(epochs, [], [keep_every])) + 1  # and the best, wherever it is
        return cost.weights_bytes * min(1.0, kept / len(epochs)) + cost.detection_bytes

    def note(self, stage: Stage) -> str:
        """What is known of a stage."""
        return f"{stage.epochs} epochs, {stage.steps} steps, {self._state(stage)}  [{stage.key}]"

    def _state(self, stage: Stage) -> str:
        folder = self.layout.run(stage.key)
        if folder.is_done:
            return "done"
        left = self.left[stage.key]
        holder = holder_of(folder.lease)
        if holder is not None:
            return f"in training by {holder}, {1 - left:.0%}"
        begun = f"{1 - left:.0%} done, " if left < 1 else ""
        return f"{begun}{tqdm.format_interval(self.costs[stage.key].seconds * left)} to train"


def _by_detector(plan: Plan) -> str:
    """Epochs of each detector, where there are several."""
    shared: dict[str, int] = {}
    for stage in plan.stages.values():
        shared[_detector(stage)] = shared.get(_detector(stage), 0) + stage.epochs
    plain = dict.fromkeys(shared, 0)
    for trial in plan.trials:
        for key in trial.stages:
            plain[_detector(plan.stages[key])] += plan.stages[key].epochs
    if len(shared) < 2:
        return ""
    return f" ({', '.join(f'{name} {shared[name]} of {plain[name]}' for name in sorted(shared))})"


def _detector(stage: Stage) -> str:
    """Name of its class."""
    return str(stage.config["detector"]["_target_"]).rpartition(".")[2]


def _bytes(count: float) -> str:
    return str(tqdm.format_sizeof(count, "B", 1000))
