"""The loop of a sweep, over stages that are trained once for all tests here."""

import json
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from fl3d.core import leases
from fl3d.core.errors import ConfigError, StageFailed, StoreError
from fl3d.core.leases import Holder, leased
from fl3d.core.records import Config
from fl3d.runs.opening import open_sweep
from fl3d.runs.plans import read_plan
from fl3d.store.base import RunStatus
from fl3d.store.memory import MemoryStore
from fl3d.store.opening import open_store
from fl3d.sweep.launchers.base import Job
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.launchers.local import LocalLauncher
from fl3d.sweep.run import run_sweep
from fl3d.sweep.setup import Prepared, left_out, prepare_sweep
from fl3d.sweep.sweepers.base import Advice, Point, Standing, Sweeper, TrialState
from fl3d.sweep.sweepers.grid import Listed, point_of
from tests.support import run_small, small_config, small_sweep, train_stages

POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]
LONGER = ("schedule.stages.warmup.epochs=3",)


@pytest.fixture(scope="module")
def trained(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root whose stages are all trained, and which no sweep was run on."""
    root = tmp_path_factory.mktemp("trained")
    train_stages(small_sweep(simulated, root, POINTS, *LONGER))
    return root


@pytest.fixture
def sweep(simulated: Path, trained: Path, tmp_path: Path) -> Prepared:
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    return small_sweep(simulated, tmp_path, POINTS, *LONGER)


def statuses(store: MemoryStore) -> list[RunStatus]:
    return [run.status for run in store.runs.values()]


def last_stage(sweep: Prepared, number: int) -> Path:
    return sweep.layout.run(sweep.plan.trials[number].key).path


class Ending(InlineLauncher):
    """Ends a stage by an exception."""

    def __init__(self, key: str, error: BaseException) -> None:
        self.key = key
        self.error = error
        self.is_closed = False

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        if folder.name == self.key:
            (folder / "stage.json").write_text("{}")  # so that the stage raises
            if not isinstance(self.error, Exception):
                raise self.error
        return super().launch(folder, after)

    def close(self) -> None:
        self.is_closed = True


def test_what_is_trained_is_logged_and_not_trained_again(sweep: Prepared) -> None:
    ran = run_small(sweep)
    assert ran.outcome.trained == []
    assert set(ran.outcome.reused) == set(sweep.plan.stages)
    assert [one.state for one in ran.standings.values()] == [TrialState.DONE] * 2
    store = ran.recorder.store
    assert isinstance(store, MemoryStore)
    assert statuses(store) == [RunStatus.DONE] * 2
    for run in store.runs.values():
        assert sorted(run.scores) == [2, 4, 6, 8, 10]
        assert run.files["pictures"] == ["birds_eye.png"]


def test_a_start_with_fewer_trials_says_which_it_leaves_out(
    sweep: Prepared, simulated: Path, tmp_path: Path
) -> None:
    run_small(replace(sweep, words=("+sweep=gamma", "data.root=my data")))
    less = small_sweep(simulated, tmp_path, POINTS[:1], *LONGER)
    said: list[str] = []
    run_sweep(less, InlineLauncher(), MemoryStore(less.settings.store.root), said.append)
    told = next(line for line in said if line.startswith("The start before had 1 trial of"))
    assert "(VoxelNet 2 seed 0)" in told
    assert told.endswith("python -m fl3d -m +sweep=gamma 'data.root=my data'")
    assert left_out(sweep) == ""  # more trials than before


def test_a_factor_that_does_not_vary_is_refused_before_frames_are_simulated(tmp_path: Path) -> None:
    words = ("data.generate=true", "sweep.factor=loss.alpha")
    with pytest.raises(ConfigError, match=r"^sweep\.factor: loss\.alpha .* Swept: loss\.gamma\."):
        small_sweep(tmp_path / "data", tmp_path, POINTS, *words)
    assert not (tmp_path / "data").exists()


def test_a_sweep_that_was_run_can_be_opened(sweep: Prepared) -> None:
    """Through the store that its config names."""
    store = open_store(sweep.settings.store.root, sweep.settings.store.uri)
    run_small(sweep, store=store)
    finished = open_sweep(sweep.settings)
    assert [trial.key for trial in finished.trials] == [trial.key for trial in sweep.plan.trials]
    assert finished.factor == ("loss.gamma",)
    assert finished.levels == ["0", "2"]
    assert finished.baseline == "0"
    assert len(finished.scores) == 2 * 5
    assert set(finished.scores["group"]) == {"VoxelNet"}
    assert finished.plan.trials[1].values == {"detector": "voxelnet", "loss.gamma": 2}
    assert finished.plan.trials[1].value("loss.gamma") == 2


def test_weights_that_nobody_needs_are_dropped_when_the_store_has_the_models(
    sweep: Prepared,
) -> None:
    warmup = sweep.layout.run(sweep.plan.trials[0].stages[0])
    assert [warmup.weights(step).exists() for step in (2, 4, 6)] == [True, True, True]
    ran = run_small(sweep)
    kept = [step for step in (2, 4, 6) if warmup.weights(step).exists()]
    assert kept[-1] == 6
    assert len(kept) < 3  # the last and the best
    assert warmup.steps() == [2, 4, 6]
    store = ran.recorder.store
    assert isinstance(store, MemoryStore)
    assert all(set(run.models) == {"last", "best"} for run in store.runs.values())


def test_models_that_were_deleted_in_the_ui_are_made_again(sweep: Prepared) -> None:
    """Of a run that is closed: what is whole is not touched."""
    store = MemoryStore(sweep.settings.store.root)
    run_small(sweep, store=store)
    first, second = store.runs.values()
    del first.models["best"]
    second.files.clear()
    ran = run_small(sweep, store=store)
    assert ran.outcome.trained == []
    assert set(first.models) == {"last", "best"}
    assert statuses(store) == [RunStatus.DONE] * 2
    assert not second.files


def test_a_plan_remembers_the_stages_of_earlier_starts(sweep: Prepared, simulated: Path) -> None:
    """Nobody's waste, though the sweep has other trials now."""
    run_small(sweep)
    root = sweep.settings.store.root.parent
    narrower = small_sweep(simulated, root, POINTS[1:], *LONGER)
    run_small(narrower)
    plan = read_plan(sweep.layout.plan(sweep.settings.experiment))
    assert [trial.key for trial in plan.trials] == [sweep.plan.trials[1].key]
    assert plan.earlier == (sweep.plan.trials[0].key,)
    assert plan.stages == set(sweep.plan.stages)


def test_a_stage_that_fails_closes_its_trials_run_alone(sweep: Prepared) -> None:
    shutil.rmtree(last_stage(sweep, 1))
    store = MemoryStore(sweep.settings.store.root)
    launcher = Ending(sweep.plan.trials[1].key, ValueError())
    with pytest.raises(StageFailed, match="1 stage"):
        run_small(sweep, launcher, store)
    assert statuses(store) == [RunStatus.DONE, RunStatus.FAILED]
    assert launcher.is_closed


def test_an_interrupted_sweep_resumes(sweep: Prepared) -> None:
    shutil.rmtree(last_stage(sweep, 1))
    store = MemoryStore(sweep.settings.store.root)
    launcher = Ending(sweep.plan.trials[1].key, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run_small(sweep, launcher, store)
    assert launcher.is_closed
    assert RunStatus.RUNNING not in statuses(store)
    ran = run_small(sweep, store=store)
    assert ran.outcome.trained == [sweep.plan.trials[1].key]
    assert statuses(store) == [RunStatus.DONE] * 2


class OneByOne(Sweeper):
    """Proposes a trial when the one before is done."""

    listens = True
    swept = ("detector", "loss.gamma")

    def __init__(self, points: Sequence[Point], base: Config) -> None:
        self.points = list(points)
        self.base = base
        self.n_trials = len(points)
        self.heard: list[dict[int, float]] = []

    def first(self) -> Sequence[Point]:
        return ()

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        if any(one.state is TrialState.RUNNING for one in standings.values()):
            return Advice()
        for one in standings.values():
            self.heard.append({epoch: aps["ap_3d/easy"] for epoch, aps in one.curve.items()})
        return Advice([self.points.pop(0)]) if self.points else Advice()


def test_a_sweeper_may_propose_trials_while_it_runs(
    sweep: Prepared, simulated: Path, tmp_path: Path
) -> None:
    configs = [small_config(simulated, tmp_path, *LONGER, *point) for point in POINTS]
    points = [point_of(point, config) for point, config in zip(POINTS, configs, strict=True)]
    sweeper = OneByOne(points, configs[0])
    prepared = prepare_sweep(sweeper)
    assert prepared.plan.trials == ()
    ran = run_small(prepared)
    assert [trial.key for trial in ran.plan.trials] == [trial.key for trial in sweep.plan.trials]
    assert [sorted(curve) for curve in sweeper.heard[-2:]] == [[1, 2], [1, 2]]
    plan = read_plan(prepared.layout.plan(prepared.settings.experiment))
    assert [trial.level for trial in plan.trials] == ["0", "2"]


def test_a_sweep_without_trials_is_refused() -> None:
    with pytest.raises(ConfigError, match="at least one trial"):
        prepare_sweep(Listed([]))


def test_the_same_sweep_is_not_started_twice(sweep: Prepared) -> None:
    lease = sweep.layout.lease(sweep.settings.experiment)
    message = f"in use by process {os.getpid()}"
    with leased(lease), pytest.raises(StoreError, match=message):
        run_small(sweep)


def test_a_second_machine_is_refused_where_the_store_is_for_one(
    sweep: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite would be destroyed by two that write to it over a shared folder."""
    other = Holder("token", "elsewhere", "another system", 1, "0")
    lease = sweep.layout.lease("another-sweep")
    lease.parent.mkdir(parents=True)
    lease.write_text(json.dumps(asdict(other)))
    wait = time.sleep
    # It renews its lease while it is being watched.
    monkeypatch.setattr(leases.time, "sleep", lambda seconds: (wait(seconds), os.utime(lease)))
    message = "process 1 on elsewhere runs a sweep on this store"
    with pytest.raises(StoreError, match=message):
        run_small(sweep)


def test_local_stages_may_have_loader_workers(simulated: Path, tmp_path: Path) -> None:
    sweep = small_sweep(simulated, tmp_path, POINTS[:1], "workers=1")
    assert len(run_small(sweep, LocalLauncher(1)).outcome.trained) == 2
