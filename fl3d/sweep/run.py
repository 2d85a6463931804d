"""Run a sweep: the loop from what a sweeper proposes to a store that holds every score.

Read this first: ``run_sweep`` is the whole of it. Nothing here trains; stages do, wherever the launcher starts them.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fl3d.config.settings import Settings, read_settings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.leases import holder_of, leased
from fl3d.core.provenance import provenance, uncommitted
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.detections import read_validation
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import read_plan, write_plan
from fl3d.runs.retention import superfluous_weights
from fl3d.runs.spec import Machine
from fl3d.store.base import Store
from fl3d.store.opening import open_store
from fl3d.sweep.cost import Costs
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.notes import announcement, note
from fl3d.sweep.pictures import draw_frame_with_most_cars
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.prepare import PreparedData, prepare_data
from fl3d.sweep.progress import Progress
from fl3d.sweep.recorder import Recorder, Subject
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.standings import no_curve, stand
from fl3d.sweep.sweepers.base import Standing, Sweeper

POLL_SECONDS = 0.2  # a stage takes minutes; this is a five hundredth of a tiny one


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A sweep whose data are at hand and whose first trials are planned.

    Args:
        sweeper: proposes its trials.
        settings: what all trials share.
        data: where the frames lie.
        planner: lays out what the sweeper proposes.
        plan: of the trials that are known beforehand.
    """

    sweeper: Sweeper
    settings: Settings
    data: PreparedData
    planner: Planner
    plan: Plan

    @property
    def layout(self) -> StoreFolder:
        """Of its store folder."""
        return StoreFolder(self.settings.store.root)

    @property
    def kitti(self) -> KittiFolder:
        """Its frames."""
        return KittiFolder(self.data.root, self.settings.data.crop, self.settings.data.calibration)


@dataclass(frozen=True, kw_only=True)
class Ran:
    """What a sweep has come to.

    Args:
        plan: as it has grown.
        outcome: what became of its stages.
        standings: how its trials stand.
        recorder: what wrote them to the store.
    """

    plan: Plan
    outcome: Outcome
    standings: Mapping[str, Standing]
    recorder: Recorder


def prepare_sweep(sweeper: Sweeper) -> Prepared:
    """Find or simulate the data, and plan what the sweeper proposes first.

    Raises:
        ConfigError: there are no trials, or they cannot be run.
        DataError: the data cannot be used.
    """
    if not sweeper.base:
        raise ConfigError("a sweep needs at least one trial")
    settings = read_settings(sweeper.base)
    data = prepare_data(settings.data)
    info = DataInfo(data.digest, len(data.train_ids), data.image_digest)
    planner = Planner(sweeper.base, settings, sweeper.swept, info, grows=sweeper.listens)
    plan = planner.plan(sweeper.first())
    if plan.trials:
        planner.frozen(plan)  # a baseline that is no level is refused now
    return Prepared(sweeper=sweeper, settings=settings, data=data, planner=planner, plan=plan)


def run_sweep(
    prepared: Prepared,
    launcher: Launcher,
    store: Store | None = None,
    say: Callable[[str], None] = print,
) -> Ran:
    """Train what is missing, and log every score.

    Args:
        prepared: the sweep.
        launcher: where its stages run.
        store: for its scores; None: the one that its config names.
        say: prints a line for the user.

    Raises:
        StoreError: another process is running this sweep on this store, or the store cannot be reached.
    """
    settings = prepared.settings
    layout = prepared.layout
    sweeper = prepared.sweeper
    planner = prepared.planner
    store = store or open_store(settings.store.root, settings.store.uri)
    launcher.open()
    with leased(layout.lease(settings.experiment), wait=False) as lease:
        refuse_several_machines(store, layout)
        store.open()
        plan = prepared.plan
        freeze(prepared, plan)
        sweeper.open(planner.key)
        scores = Scoreboard(
            layout, read_validation(prepared.kitti, prepared.data.val_ids), settings.protocol
        )
        costs = Costs(layout.stages, len(prepared.data.val_ids))
        scheduler = Scheduler(
            machine(prepared), launcher, layout, lambda stage: costs.cost(stage).seconds
        )
        say(announcement(settings, plan, layout, launcher.slots))
        with Progress(settings.experiment, layout, costs, launcher.slots) as progress:
            recorder = Recorder(store, scores, subject(prepared, store, scores), progress.say)
            curve = scores.curve if sweeper.listens else no_curve
            tidied: set[str] = set()
            try:
                while True:
                    lease.check()
                    scheduler.step(plan)
                    standings = stand(plan, scheduler.outcome, curve)
                    if recorder.sync(standings):
                        drop_weights(
                            layout, scheduler.outcome.done - tidied, settings.store.keep_every
                        )
                        tidied |= scheduler.outcome.done
                    advice = sweeper.advise(standings, launcher.slots)
                    if advice.points:
                        plan = planner.plan(advice.points, plan)
                        freeze(prepared, plan)
                    scheduler.stop(advice.stop)
                    progress.show(plan, scheduler)
                    if scheduler.is_idle(plan):
                        break
                    time.sleep(POLL_SECONDS)
                standings = stand(plan, scheduler.outcome, scores.curve)
                recorder.finish(standings)
                drop_weights(layout, scheduler.outcome.done - tidied, settings.store.keep_every)
            except BaseException:
                recorder.interrupt()
                raise
            finally:
                scheduler.close()
    return Ran(plan=plan, outcome=scheduler.outcome, standings=standings, recorder=recorder)


def machine(prepared: Prepared) -> Machine:
    """Settings under which this machine starts stages."""
    settings = prepared.settings
    return Machine(
        data_root=prepared.data.root.absolute(),
        train_ids=prepared.data.train_ids,
        val_ids=prepared.data.val_ids,
        protocol=settings.protocol,
        device=settings.device,
        workers=settings.workers,
        cache_frames=settings.data.cache_frames,
        save_every_steps=settings.save_every_steps,
        keep_every=settings.store.keep_every,
        provenance=provenance(),
    )


def freeze(prepared: Prepared, plan: Plan) -> None:
    """Keep the plan, so that its trials can be told later, whatever configs say then.

    Stages of earlier starts under the same name are remembered too: they are nobody's waste.
    """
    if not plan.trials:
        return
    path = prepared.layout.plan(prepared.settings.experiment)
    try:
        earlier = read_plan(path).stages
    except StoreError:  # the first start, or one of another version
        earlier = set()
    write_plan(path, prepared.planner.frozen(plan, earlier))


def refuse_several_machines(store: Store, layout: StoreFolder) -> None:
    """Refuse a second machine where the store is for one at a time.

    Raises:
        StoreError: another machine runs a sweep on this root.
    """
    if not store.is_for_one_machine:
        return
    for path in layout.plans.glob("*.lease"):
        holder = holder_of(path)
        if holder is not None and holder.host != socket.gethostname():
            raise StoreError(
                f"{path}: {holder} runs a sweep on this store, and SQLite is for one machine at a time; "
                "give both a server: store.uri=postgresql://USER@HOST/NAME or http://HOST:PORT"
            )


def drop_weights(layout: StoreFolder, keys: set[str], keep_every: int | None) -> None:
    """Delete weights that nobody needs of stages that are done, once the store has their models."""
    for key in keys:
        for path in superfluous_weights(layout.run(key), keep_every):
            path.unlink(missing_ok=True)


def subject(prepared: Prepared, store: Store, scores: Scoreboard) -> Subject:
    """What the recorder writes of every trial."""
    settings = prepared.settings
    made_by = provenance()
    changes = uncommitted() if "fl3d.diff" in made_by else ""
    return Subject(
        experiment=store.experiment(settings.experiment, note(settings)),
        factor=prepared.planner.design.factor,
        best_among=settings.best_among,
        dataset=(settings.folder_name, prepared.data.digest),
        data_root=prepared.data.root,
        tags={**made_by, "fl3d.evaluator": settings.protocol.id},
        files={"uncommitted.patch": changes} if changes else {},
        draw=draw_frame_with_most_cars(
            prepared.layout, prepared.kitti, scores.validation, settings.protocol
        ),
    )
