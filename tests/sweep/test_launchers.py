"""The contract of every launcher, run over each YAML in conf/hydra/launcher.

SLURM and Ray are run where they are to be had: `make test-slurm` and `make test-ray` install and start them.
"""

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fl3d.config import CONF, build, multirun
from fl3d.errors import StageFailed
from fl3d.leases import holder_of
from fl3d.pipeline import Sweep
from fl3d.records import StagePaths
from fl3d.sweep.launchers.base import JobState, Launcher
from fl3d.training.run import write_spec
from tests.support import small_sweep

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


def warmup(sweep: Sweep) -> StagePaths:
    return StagePaths(sweep.stages_root / sweep.plan.trials[0].stages[0])


def kill_trainer(paths: StagePaths) -> None:
    holder = holder_of(paths.lease)
    assert holder is not None
    os.kill(holder.pid, signal.SIGKILL)


def test_it_trains_a_sweep_to_its_scores(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS)
    launcher = make(name)
    outcome = sweep.run(launcher)
    assert len(outcome.trained) == 3
    assert launcher.slots >= 1


def test_it_brings_back_the_error(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS, "data.cache_frames=0")
    victim = simulated / "training" / "velodyne" / f"{sweep.data.train_ids[0]}.bin"
    whole = victim.read_bytes()
    try:
        victim.write_bytes(whole[:-3])
        with pytest.raises(StageFailed, match="not a whole number of points"):
            sweep.run(make(name))
    finally:
        victim.write_bytes(whole)


def test_a_killed_stage_goes_on_from_its_checkpoint(name: str, simulated: Path, shared: Path) -> None:
    if name == "inline":
        pytest.skip("inline runs in this very process")
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    paths = warmup(sweep)
    kept: list[int] = []

    def kill() -> None:
        kept.extend(paths.steps())
        kill_trainer(paths)

    killer = when(lambda: len(paths.steps()) >= 2 and holder_of(paths.lease), kill)
    outcome = sweep.run(make(name))
    killer.join()
    assert kept
    assert len(outcome.trained) == 2
    assert len(paths.steps()) == 40


def test_a_cancelled_stage_ends_and_keeps_its_checkpoints(name: str, simulated: Path, shared: Path) -> None:
    if name == "inline":
        pytest.skip("inline is done when launch returns")
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    paths, stage = warmup(sweep), sweep.plan.stages[sweep.plan.trials[0].stages[0]]
    write_spec(paths, stage, sweep.machine())
    launcher = make(name)
    job = launcher.launch(paths.folder)
    deadline = time.monotonic() + PATIENCE
    while not paths.steps():
        assert time.monotonic() < deadline
        assert job.state() is JobState.RUNNING
        time.sleep(0.05)
    job.cancel()
    while holder_of(paths.lease) is not None:
        assert time.monotonic() < deadline, "the process lives on"
        time.sleep(0.1)
    launcher.close()
    assert 0 < len(paths.steps()) < 40
    assert not paths.done.exists()


def scontrol(*arguments: str) -> str:
    return subprocess.run(["scontrol", *arguments], capture_output=True, text=True, check=True).stdout


def job_of(paths: StagePaths) -> str:
    import json

    return str(json.loads((paths.folder / "slurm.json").read_text())["job"])


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_slurm_holds_children_until_their_parent_is_done(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    parent, children = warmup(sweep), [StagePaths(sweep.stages_root / trial.key) for trial in sweep.plan.trials]
    seen: list[str] = []

    def look() -> None:
        assert not parent.done.exists()
        seen.extend(scontrol("-o", "show", "job", job_of(child)) for child in children)

    looker = when(lambda: all((child.folder / "slurm.json").exists() for child in children), look)
    sweep.run(make(name))
    looker.join()
    assert len(seen) == 2
    assert all(f"Dependency=afterok:{job_of(parent)}" in line and "JobState=PENDING" in line for line in seen)


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_a_requeued_job_goes_on(name: str, simulated: Path, shared: Path) -> None:
    """As after a pre-emption: SLURM itself starts the same job again."""
    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    paths = warmup(sweep)
    requeue = when(lambda: len(paths.steps()) >= 2, lambda: scontrol("requeue", job_of(paths)))
    outcome = sweep.run(make(name))
    requeue.join()
    assert len(outcome.trained) == 3
    assert "Restarts=1" in scontrol("-o", "show", "job", job_of(paths)) or len(paths.steps()) == 40


@pytest.mark.parametrize("name", ["slurm"], indirect=True)
def test_a_job_outlives_the_sweep_and_is_taken_up_again(name: str, simulated: Path, shared: Path) -> None:
    sweep = small_sweep(simulated, shared, POINTS[:1], *LONG)
    paths, stage = warmup(sweep), sweep.plan.stages[sweep.plan.trials[0].stages[0]]
    write_spec(paths, stage, sweep.machine())
    make(name).launch(paths.folder)
    first = job_of(paths)
    outcome = sweep.run(make(name))
    assert job_of(paths) == first
    assert len(outcome.trained) + len(outcome.reused) == 2


@pytest.mark.parametrize("name", ["ray"], indirect=True)
def test_two_stages_share_a_card_on_ray(name: str) -> None:
    launcher = make(name, "hydra.launcher.gpus=0.5", "hydra.launcher.cpus=0.1")
    assert launcher.slots == 2  # one node claims a card


@pytest.mark.parametrize("name", ["ray"], indirect=True)
def test_a_ray_node_may_die_in_the_middle_of_a_stage(name: str, simulated: Path, shared: Path) -> None:
    """The last one here, as the cluster is smaller afterwards."""
    from tests.services.ray_nodes import remove_node_of

    sweep = small_sweep(simulated, shared, POINTS, *LONG)
    paths = warmup(sweep)
    pids: list[int] = []

    def kill() -> None:
        holder = holder_of(paths.lease)
        assert holder is not None
        pids.append(holder.pid)
        remove_node_of(holder.pid)

    killer = when(lambda: len(paths.steps()) >= 2 and holder_of(paths.lease), kill)
    launcher = make(name)
    assert launcher.slots == 3
    outcome = sweep.run(launcher)
    killer.join()
    assert pids
    assert len(outcome.trained) == 3
    assert len(paths.steps()) == 40
