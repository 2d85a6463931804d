"""The contract of every launcher, run over each YAML in conf/hydra/launcher.

SLURM and Ray are run where they are to be had: `make test-slurm` and `make test-ray` install and
start them.
"""

import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from fl3d.config.compose import CONF, multirun
from fl3d.config.objects import build
from fl3d.core.errors import StageFailed
from fl3d.core.leases import holder_of
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec, write_spec
from fl3d.sweep.checked import check_start
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.sweep.launchers.local import LocalLauncher
from fl3d.sweep.setup import Prepared, machine
from tests.support import last_weights, run_small, small_sweep

LAUNCHERS = sorted(path.stem for path in (CONF / "hydra" / "launcher").glob("*.yaml"))
POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]
LONG = ("schedule.stages.warmup.epochs=40",)  # long enough to be disturbed
PATIENCE = 120.0  # seconds


def make(name: str, *overrides: str) -> Launcher:
    section = multirun([f"hydra/launcher={name}", *overrides]).launcher
    launcher: Launcher = build(section, "hydra.launcher")
    launcher.open()
    return launcher


@pytest.fixture(scope="session")
def _ray_cluster() -> Iterator[None]:
    """Three nodes of one CPU each, as processes of this machine."""
    pytest.importorskip("ray", reason="Ray is not installed; make test-ray installs it")
    from tests.services.ray_nodes import cluster

    with cluster():
        yield


@pytest.fixture(params=LAUNCHERS)
def name(request: pytest.FixtureRequest) -> str:
    if request.param == "slurm" and not (os.environ.get("SLURM_CONF") and shutil.which("sbatch")):
        pytest.skip("no SLURM here; make test-slurm starts one")
    if request.param == "ray":
        request.getfixturevalue("_ray_cluster")
    return str(request.param)


@pytest.fixture
def shared(tmp_path: Path) -> Path:
    """A folder that every node sees; SLURM's jobs are the same user's."""
    return tmp_path


def when(condition: object, action: object) -> threading.Thread:
    """Do something as soon as a condition holds, while the sweep runs."""

    def wait() -> None:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if condition():  # type: ignore[operator]
                action()  # type: ignore[operator]
                return
            time.sleep(0.05)

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


def warmup(sweep: Prepared) -> RunFolder:
    return sweep.layout.run(sweep.plan.trials[0].stages[0])


def write_spec_of(sweep: Prepared, folder: RunFolder) -> None:
    """As the scheduler does before it launches a stage."""
    write_spec(folder, Spec(sweep.plan.stages[folder.key], machine(sweep)))


def kill_trainer(folder: RunFolder) -> None:
    holder = holder_of(folder.lease)
    assert holder is not None
    os.kill(holder.pid, signal.SIGKILL)


def test_it_trains_a_sweep_to_its_scores(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS)
    launcher = make(name)
    ran = run_small(sweep, launcher)
    assert len(ran.outcome.trained) == 3
    assert all(len(ran.recorder.store.logged_steps(run)) == 4 for run in ran.recorder.runs)
    assert launcher.slots >= 1


def test_it_brings_back_the_error(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS, "data.cache_frames=0")
    victim = simulated / "training" / "velodyne" / f"{sweep.data.train_ids[0]}.bin"
    whole = victim.read_bytes()
    check_start(sweep, lambda line: None)  # while it is whole; a start would refuse it
    try:
        victim.write_bytes(whole[:-3])
        with pytest.raises(StageFailed, match="not a whole number of points"):
            run_small(sweep, make(name))
    finally:
        victim.write_bytes(whole)


def test_a_killed_stage_resumes_from_its_checkpoint(
    name: str, simulated: Path, shared: Path
) -> None:
    if name == "inline":
        pytest.skip("inline runs in this very process")
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    folder = warmup(sweep)
    kept: list[int] = []

    def kill() -> None:
        kept.extend(folder.steps())
        kill_trainer(folder)

    killer = when(lambda: len(folder.steps()) >= 2 and holder_of(folder.lease), kill)
    ran = run_small(sweep, make(name))
    killer.join()
    assert kept
    assert len(ran.outcome.trained) == 2
    assert len(folder.steps()) == 40


@pytest.mark.parametrize("kills", [2, 3])
def test_a_server_that_is_killed_as_it_forks_is_started_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kills: int
) -> None:
    launcher = LocalLauncher(1)
    starts: list[int] = []

    class Process:
        exitcode = None

        def __init__(self, target: object, args: object) -> None:
            starts.append(0)

        def start(self) -> None:
            if len(starts) <= kills:
                raise EOFError("unexpected EOF")

    monkeypatch.setattr(launcher, "_context", SimpleNamespace(Process=Process))
    monkeypatch.setattr(launcher, "open", lambda: None)
    monkeypatch.setattr("fl3d.sweep.launchers.local._Worker.give", lambda *_: True)
    monkeypatch.setattr("fl3d.sweep.launchers.local.SERVER_SECONDS", 0.0)
    if kills == 3:
        with pytest.raises(StageFailed, match="killed 3 times"):
            launcher.launch(tmp_path)
    else:
        assert launcher.launch(tmp_path).state() is JobState.RUNNING
    assert len(starts) == 3


def test_a_cancelled_stage_ends_and_keeps_its_checkpoints(
    name: str, simulated: Path, shared: Path
) -> None:
    if name == "inline":
        pytest.skip("inline is done when launch returns")
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    folder = warmup(sweep)
    write_spec_of(sweep, folder)
    launcher = make(name)
    job = launcher.launch(folder.path)
    deadline = time.monotonic() + PATIENCE
    while not folder.steps():
        assert time.monotonic() < deadline
        assert job.state() is JobState.RUNNING
        time.sleep(0.05)
    job.cancel()
    while holder_of(folder.lease) is not None:
        assert time.monotonic() < deadline, "the process lives on"
        time.sleep(0.1)
    launcher.close()
    assert 0 < len(folder.steps()) < 40
    assert not folder.is_done


def test_stages_that_follow_one_another_share_a_process_and_train_to_the_same_bits(
    simulated: Path, tmp_path: Path
) -> None:
    """Two detectors, each with its warm-up: beside each other in one store, and in a process each in others."""
    points = [[f"detector={name}", "loss.gamma=2"] for name in ("fcn3d", "voxelnet")]
    together = small_sweep(simulated, tmp_path / "both", points)
    launcher = SeenLauncher(1)
    run_small(together, launcher)
    assert len(launcher.pids) == 4
    assert len(set(launcher.pids)) == 1
    for number, point in enumerate(points):
        alone = small_sweep(simulated, tmp_path / str(number), [point])
        run_small(alone, LocalLauncher(1))
        key = alone.plan.trials[0].stages[-1]
        assert key in together.plan.stages
        own, shared = (last_weights(one.layout.stages, key) for one in (alone, together))
        assert own == shared


def test_a_stage_after_one_that_failed_has_a_process_of_its_own(
    simulated: Path, tmp_path: Path
) -> None:
    sweep = small_sweep(simulated, tmp_path, POINTS[:1])
    launcher = SeenLauncher(1)
    nowhere = RunFolder(tmp_path / "nowhere")
    nowhere.path.mkdir()
    write_spec_of(sweep, warmup(sweep))
    for folder, state in ((nowhere, JobState.RAISED), (warmup(sweep), JobState.DONE)):
        job = launcher.launch(folder.path)
        deadline = time.monotonic() + PATIENCE
        while not job.state().is_finished():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert job.state() is state
    assert len(set(launcher.pids)) == 2
    last = launcher._workers[0].process
    assert last.is_alive()
    launcher.close()
    last.join(PATIENCE)
    assert last.exitcode == 0


class SeenLauncher(LocalLauncher):
    """Tells in which process each stage ran."""

    def __init__(self, slots: int) -> None:
        super().__init__(slots)
        self.pids: list[int | None] = []

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        job = super().launch(folder, after)
        self.pids.append(self._workers[0].process.pid)
        return job


def scontrol(*arguments: str) -> str:
    command = ["scontrol", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def job_of(folder: RunFolder) -> str:
    return str(json.loads((folder.path / "slurm.json").read_text())["job"])


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_slurm_holds_children_until_their_parent_is_done(
    name: str, simulated: Path, shared: Path
) -> None:
    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    parent = warmup(sweep)
    children = [sweep.layout.run(trial.key) for trial in sweep.plan.trials]
    seen: list[str] = []

    def look() -> None:
        assert not parent.is_done
        seen.extend(scontrol("-o", "show", "job", job_of(child)) for child in children)

    looker = when(lambda: all((child.path / "slurm.json").exists() for child in children), look)
    run_small(sweep, make(name))
    looker.join()
    assert len(seen) == 2
    assert all(f"Dependency=afterok:{job_of(parent)}" in line for line in seen)
    assert all("JobState=PENDING" in line for line in seen)


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_a_requeued_job_resumes(name: str, simulated: Path, shared: Path) -> None:
    """As after a pre-emption: SLURM itself starts the same job again."""
    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    folder = warmup(sweep)
    requeue = when(lambda: len(folder.steps()) >= 2, lambda: scontrol("requeue", job_of(folder)))
    ran = run_small(sweep, make(name))
    requeue.join()
    assert len(ran.outcome.trained) == 3
    assert (
        "Restarts=1" in scontrol("-o", "show", "job", job_of(folder)) or len(folder.steps()) == 40
    )


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_a_job_outlives_the_sweep_and_is_taken_up_again(
    name: str, simulated: Path, shared: Path
) -> None:
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    folder = warmup(sweep)
    write_spec_of(sweep, folder)
    make(name).launch(folder.path)
    first = job_of(folder)
    ran = run_small(sweep, make(name))
    assert job_of(folder) == first
    assert len(ran.outcome.trained) + len(ran.outcome.reused) == 2


@pytest.mark.parametrize("name", ["ray"], indirect=True)
def test_two_stages_share_a_card_on_ray(name: str) -> None:
    launcher = make(name, "hydra.launcher.gpus=0.5", "hydra.launcher.cpus=0.1")
    assert launcher.slots == 2  # one node claims a card


@pytest.mark.parametrize("name", ["ray"], indirect=True)
def test_a_ray_node_may_die_in_the_middle_of_a_stage(
    name: str, simulated: Path, shared: Path
) -> None:
    """The last one here, as the cluster is smaller afterwards."""
    from tests.services.ray_nodes import remove_node_of

    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    folder = warmup(sweep)
    pids: list[int] = []

    def kill() -> None:
        holder = holder_of(folder.lease)
        assert holder is not None
        pids.append(holder.pid)
        remove_node_of(holder.pid)

    killer = when(lambda: len(folder.steps()) >= 2 and holder_of(folder.lease), kill)
    launcher = make(name)
    assert launcher.slots == 3
    ran = run_small(sweep, launcher)
    killer.join()
    assert pids
    assert len(ran.outcome.trained) == 3
    assert len(folder.steps()) == 40
