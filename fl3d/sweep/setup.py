"""What a sweep needs before its loop begins: data, a first plan, and what is known of this machine."""

from __future__ import annotations

import shlex
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from fl3d.config.places import own_folders
from fl3d.config.settings import Settings, read_settings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.leases import living
from fl3d.core.provenance import provenance, uncommitted
from fl3d.core.records import Stage, Trial
from fl3d.data.classes import CARS
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.validation import read_validation
from fl3d.reports.rounds import listed
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import PlanFile, read_plan
from fl3d.runs.spec import Machine, read_spec
from fl3d.store.base import Store
from fl3d.sweep.expected import expect_data
from fl3d.sweep.identity import reading
from fl3d.sweep.notes import note
from fl3d.sweep.pictures import draw_frame_with_most_objects
from fl3d.sweep.places import check_places
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner, check_shared
from fl3d.sweep.prepare import PreparedData, is_prepared, prepare_data
from fl3d.sweep.recorder import Subject
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.sweepers.base import Point, Sweeper
from fl3d.training.command import is_command

NAMED = 3  # trials, of those that an earlier start had


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A sweep whose data are at hand and whose first trials are planned.

    Args:
        sweeper: proposes its trials.
        settings: what all trials share.
        data: where the frames lie.
        planner: lays out what the sweeper proposes.
        plan: of the trials that are known beforehand.
        words: of the command line; empty: it was not started from one.
        looks_before: of the plan that an earlier start has left, see ``runs.plans.FrozenPlan``.
    """

    sweeper: Sweeper
    settings: Settings
    data: PreparedData
    planner: Planner
    plan: Plan
    looks_before: tuple[int, ...]
    words: tuple[str, ...] = ()

    @property
    def layout(self) -> StoreFolder:
        """Of its store folder."""
        return StoreFolder(self.settings.store.root)

    @property
    def kitti(self) -> KittiFolder:
        """Its frames."""
        return self.settings.data.folder(self.data.root)


def prepare_sweep(sweeper: Sweeper, words: Sequence[str] = ()) -> Prepared:
    """Find or simulate the data, and plan what the sweeper proposes first.

    Args:
        sweeper: proposes the trials.
        words: of the command line, which the plan keeps.

    Raises:
        ConfigError: there are no trials, they cannot be run, or what they come to cannot be written.
        DataError: the data cannot be used.
    """
    if not sweeper.base:
        raise ConfigError("a sweep needs at least one trial")
    settings = read_settings(sweeper.base)
    check_places(settings)
    points = sweeper.first()
    check_shared(points, sweeper.base)  # before frames are simulated
    if points and settings.sweep.factor and not is_prepared(settings.data):
        # A slip there costs no simulation; frames that are there are read once, below.
        _first_plan(sweeper, settings, expect_data(settings.data).info, points)
    data = prepare_data(settings.data)
    info = DataInfo(data.digest, len(data.train_ids), data.image_digest)
    planner, plan = _first_plan(sweeper, settings, info, points)
    before = looks_before(settings, plan)
    planner.looks = paid_looks(before, sweeper.looks, [trial.seed for trial in plan.trials])
    return Prepared(
        sweeper=sweeper,
        settings=settings,
        data=data,
        planner=planner,
        plan=plan,
        looks_before=before,
        words=tuple(words),
    )


def _first_plan(
    sweeper: Sweeper, settings: Settings, info: DataInfo, points: Sequence[Point]
) -> tuple[Planner, Plan]:
    """A planner, and its plan of the first points, which compares what was asked for."""
    planner = Planner(sweeper.base, settings, sweeper.swept, info, grows=sweeper.listens)
    plan = planner.plan(points)
    if plan.trials:
        planner.check(plan)
    return planner, plan


def paid_looks(
    before: tuple[int, ...], own: tuple[int, ...], seeds: Sequence[int]
) -> tuple[int, ...]:
    """Looks that a sweep's error is spent over: its own, and those of earlier starts, which it cannot take back. Pure.

    Args:
        before: of earlier starts.
        own: of this start; empty: it looks once, when all is trained.
        seeds: of its trials.
    """
    if not before:
        return own
    once = (max(len(set(seeds)), before[0]),)  # with fewer seeds there was nothing to see
    return tuple(sorted({*before, *(own or once)}))


def looks_kept(prepared: Prepared) -> str:
    """What to say where an earlier start added seeds until it had verdicts and this one does not; empty: none did."""
    if not prepared.looks_before or prepared.sweeper.looks:  # a sweeper that looks says so itself
        return ""
    return (
        f"An earlier start judged these trials after {listed(prepared.looks_before)} seeds. Its looks stay paid for: "
        f"the error is spent over {listed(prepared.planner.looks)} seeds, and intervals are a little wider than those "
        "of one look. Another sweep.name= with seeds of its own (seed=...) is judged once"
    )


def looks_before(settings: Settings, plan: Plan) -> tuple[int, ...]:
    """Looks of the plan of this name from an earlier start that had any of these trials.

    Raises:
        ConfigError: that is of other classes.
    """
    try:
        before = read_plan(StoreFolder(settings.store.root).plan(settings.experiment))
    except StoreError:  # the first start, or one of another version
        return ()
    own = list(settings.protocol.classes)
    known = [list(trial.config.get("classes", CARS)) for trial in before.trials[:1]]
    if known and known[0] != own and not any(_is_program(trial) for trial in plan.trials):
        raise ConfigError(
            f"sweep.name: {settings.experiment} is there already, of classes {known[0]}; give one of classes {own} a "
            f"name of its own, such as sweep.name={settings.sweep.name}_{own[0].lower()}"
        )
    now = {trial.key for trial in plan.trials}
    is_other = bool(now) and not any(trial.key in now for trial in before.trials)
    return () if is_other else before.looks


def _is_program(trial: Trial) -> bool:
    """Whether a command trains it, whose plan does not tell the classes that it is scored by."""
    return is_command(trial.config)


def scoreboard(prepared: Prepared) -> Scoreboard:
    """The scores of the sweep's stages."""
    validation = read_validation(prepared.kitti, prepared.data.val_ids)
    return Scoreboard(prepared.layout, validation, prepared.settings.protocol)


def machine(prepared: Prepared) -> Machine:
    """Settings under which this machine starts stages."""
    settings = prepared.settings
    return Machine(
        data_root=prepared.data.root.absolute(),
        train_ids=prepared.data.train_ids,
        val_ids=prepared.data.val_ids,
        labels_digest=prepared.data.labels_digest,
        protocol=settings.protocol,
        device=settings.device,
        workers=settings.workers,
        cache_frames=settings.data.cache_frames,
        save_every_steps=settings.save_every_steps,
        keep_every=settings.store.keep_every,
        provenance=provenance(),
        modules=tuple(str(folder) for folder in own_folders()),
    )


def freeze(prepared: Prepared, plan: Plan) -> None:
    """Keep the plan, so that its trials can be told later, whatever configs say then.

    Stages of earlier starts under the same name are remembered too: they are nobody's waste.
    """
    if not plan.trials:
        return
    Frozen(prepared).keep(plan)


class Frozen:
    """The plan of a sweep as it is kept, while it grows; see ``freeze``.

    Args:
        prepared: the sweep.
    """

    def __init__(self, prepared: Prepared) -> None:
        self.prepared = prepared
        self._file = PlanFile(prepared.layout.plan(prepared.settings.experiment))
        self._earlier: set[str] | None = None
        self._known = 0  # stages that were looked at, in the plan's order

    def keep(self, plan: Plan) -> None:
        """Keep the plan as it is now: what it has gained is written, and not the whole of it."""
        if not plan.trials:
            return
        new = dict(islice(plan.stages.items(), self._known, None))
        _refuse_other_reading(self.prepared.layout, new)
        self._known = len(plan.stages)
        if self._earlier is None:
            try:
                self._earlier = read_plan(self._file.path).stages
            except StoreError:  # the first start, or one of another version
                self._earlier = set()
        frozen = self.prepared.planner.frozen(plan, self._earlier)
        self._file.write(replace(frozen, words=self.prepared.words))


def left_out(prepared: Prepared) -> str:
    """What to say where the start before had trials that this one has not; empty: it had none.

    A sweeper that adds trials comes to its earlier ones by itself.
    """
    if prepared.sweeper.listens:
        return ""
    experiment = prepared.settings.experiment
    try:
        before = read_plan(prepared.layout.plan(experiment))
    except StoreError:
        return ""
    now = {trial.key for trial in prepared.plan.trials}
    left = [trial for trial in before.trials if trial.key not in now]
    if not left:
        return ""
    named = ", ".join(f"{one.group} {one.level} seed {one.seed}" for one in left[:NAMED])
    more = ", ..." if len(left) > NAMED else ""
    again = f"; to have them back: python -m fl3d -m {shlex.join(before.words)}"
    count = "1 trial" if len(left) == 1 else f"{len(left)} trials"
    return (
        f"The start before had {count} of {experiment} that this one has not ({named}{more}). They stay in the store; "
        f"tables and verdicts are of this start's{again if before.words else ''}"
    )


def _refuse_other_reading(layout: StoreFolder, stages: Mapping[str, Stage]) -> None:
    """Refuse a command whose checkpoints were read from other files than the config says now.

    Raises:
        ConfigError: naming the stage, and what to do.
    """
    for key, stage in stages.items():
        folder = layout.run(key)
        if is_command(stage.config) and folder.steps():
            before, now = reading(read_spec(folder).stage.config), reading(stage.config)
            for name in now:
                if before.get(name) != now[name]:
                    raise ConfigError(
                        f"detector.{name}: {now[name]}, but the checkpoints of {key} were read by {before.get(name)}; "
                        f"delete done.json and checkpoints in {folder.path}, and they are read anew; nothing is trained"
                    )


def refuse_several_machines(store: Store, layout: StoreFolder) -> None:
    """Refuse a second machine where the store is for one at a time.

    Raises:
        StoreError: another machine runs a sweep on this root.
    """
    if not store.is_for_one_machine:
        return
    for path, holder in living(layout.leases()).items():
        if holder.host != socket.gethostname():
            raise StoreError(
                f"{path}: {holder} runs a sweep on this store, and SQLite is for one machine at a time; "
                "give both a server: store.uri=postgresql://USER@HOST/NAME or http://HOST:PORT"
            )


def subject(prepared: Prepared, store: Store, scores: Scoreboard) -> Subject:
    """What the recorder writes of every trial."""
    settings = prepared.settings
    made_by = provenance()
    changes = uncommitted() if "fl3d.diff" in made_by else ""
    return Subject(
        experiment=store.experiment(settings.stored_as, note(settings)),
        factor=prepared.planner.design.factor,
        best_among=settings.best_among,
        dataset=(settings.folder_name, prepared.data.digest),
        data_root=prepared.data.root,
        tags={**made_by, "fl3d.evaluator": settings.protocol.id},
        files={"uncommitted.patch": changes} if changes else {},
        draw=draw_frame_with_most_objects(
            prepared.layout, prepared.kitti, scores.validation, settings.protocol
        ),
    )
