"""The store on a real PostgreSQL and on an MLflow server: many writers, and outages. `make test-postgres` runs this."""

import multiprocessing as mp
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from fl3d.errors import StoreDown
from fl3d.store.connection import database_url
from fl3d.store.tracking import Scored, Store
from fl3d.sweep.launchers.inline import InlineLauncher
from tests.support import small_sweep

SCRIPT = Path(__file__).resolve().parent / "services" / "postgres.sh"
WRITERS, TRIALS, STEPS, METRICS = 8, 4, 30, 18
POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]


def postgres(verb: str) -> str:
    folder = os.environ["FL3D_TEST_POSTGRES"]
    return subprocess.run([SCRIPT, verb, folder], capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """URL of a fresh PostgreSQL."""
    if "FL3D_TEST_POSTGRES" not in os.environ:
        pytest.skip("make test-postgres starts one")
    yield postgres("start")
    postgres("stop")


@pytest.fixture
def database(server: str, request: pytest.FixtureRequest) -> str:
    """URL of an empty database."""
    name = f"test_{abs(hash(request.node.name)) % 10**8}"
    engine = sa.create_engine(database_url(server), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    engine.dispose()
    return server.rsplit("/", 1)[0] + f"/{name}"


@pytest.fixture
def mlflow_server(database: str, tmp_path: Path) -> Iterator[str]:
    """URL of an MLflow server on that database."""
    port = 30000 + os.getpid() % 10000
    command = [
        sys.executable,
        "-m",
        "mlflow",
        "server",
        "--backend-store-uri",
        database_url(database),
        "--workers",
        "1",
    ]
    command += ["--host", "127.0.0.1", "--port", str(port), "--artifacts-destination", str(tmp_path / "artifacts")]
    environment = {**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    with (tmp_path / "server.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, start_new_session=True)
    yield f"http://127.0.0.1:{port}"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def rows(url: str, query: str) -> list[tuple[object, ...]]:
    engine = sa.create_engine(database_url(url))
    with engine.connect() as connection:
        found = [tuple(row) for row in connection.execute(sa.text(query))]
    engine.dispose()
    return found


def write(root: Path, uri: str, number: int) -> None:
    """One writer: a sweep's worth of trials, each score twice, in an experiment that all share."""
    store = Store(root, uri)
    store.open()
    experiment = store.experiment("shared", "")
    for trial in range(TRIALS):
        run = store.run(experiment, f"trial-{number}-{trial}", "paper", "name", {"detector": "VoxelNet"}, {"a": 1})
        for step in range(STEPS):
            scored = Scored(step, 1_000 + step, {f"ap_{m}": m + step / 7 for m in range(METRICS)})
            store.log(run, scored)
            store.log(run, scored)
        store.end(run, "FINISHED")


def test_eight_writers_lose_and_double_nothing(database: str, tmp_path: Path) -> None:
    """They start together on an empty database, as the tasks of a cluster do."""
    context = mp.get_context("spawn")
    writers = [context.Process(target=write, args=(tmp_path / str(n), database, n)) for n in range(WRITERS)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(timeout=300)
    assert [writer.exitcode for writer in writers] == [0] * WRITERS
    assert rows(database, "SELECT COUNT(*) FROM metrics") == [(WRITERS * TRIALS * STEPS * METRICS,)]
    assert rows(database, "SELECT COUNT(*) FROM runs WHERE status = 'FINISHED'") == [(WRITERS * TRIALS,)]
    frame = Store(tmp_path / "3", database).read("shared", ["tags.fl3d.trial"])
    assert len(frame) == TRIALS * STEPS  # each root reads its own
    assert frame["ap_5"].tolist() == [5 + step / 7 for _ in range(TRIALS) for step in range(STEPS)]


def test_a_sweep_waits_for_a_store_that_is_down(server: str, database: str, simulated: Path, tmp_path: Path) -> None:
    """PostgreSQL is stopped in the middle of training and comes back later: every score is there, once."""
    said: list[str] = []
    sweep = small_sweep(simulated, tmp_path, POINTS, f"store.uri={database}", "schedule.stages.warmup.epochs=20")
    paths = sweep.stages_root / sweep.plan.trials[0].stages[0] / "checkpoints"
    outage: list[float] = []

    def stop_and_resume() -> None:
        while len(list(paths.glob("*.json"))) < 3:
            time.sleep(0.05)
        postgres("stop")
        outage.append(len(list(paths.glob("*.json"))))
        time.sleep(25)
        outage.append(len(list(paths.glob("*.json"))))
        postgres("resume")

    from fl3d.sweep.launchers.local import LocalLauncher

    thread = threading.Thread(target=stop_and_resume)
    thread.start()
    sweep.say = said.append
    outcome = sweep.run(LocalLauncher(1))
    thread.join()
    assert len(outcome.trained) == 3
    assert outage[1] > outage[0], "training stood still during the outage"
    query = "SELECT run_uuid, step, COUNT(*) FROM metrics WHERE key = 'ap_3d/moderate' GROUP BY run_uuid, step"
    counts = rows(database, query)
    assert len(counts) == 2 * 22
    assert {count for _, _, count in counts} == {1}
    assert rows(database, "SELECT DISTINCT status FROM runs") == [("FINISHED",)]


def test_a_store_that_is_down_from_the_start_is_named(tmp_path: Path) -> None:
    pytest.importorskip("psycopg2", reason="make test-postgres installs it")
    with pytest.raises(StoreDown, match="connection to server"):
        Store(tmp_path, "postgresql://postgres@127.0.0.1:1/none").open()


def test_a_sweep_through_an_mlflow_server(mlflow_server: str, database: str, simulated: Path, tmp_path: Path) -> None:
    """What the server gives back is what lies in its database."""
    store = Store(tmp_path / "runs", mlflow_server)
    deadline = time.monotonic() + 120
    while True:
        try:
            store.open()
            break
        except StoreDown:
            assert time.monotonic() < deadline
            time.sleep(1)
    sweep = small_sweep(simulated, tmp_path, POINTS, f"store.uri={mlflow_server}")
    assert len(sweep.run(InlineLauncher()).trained) == 3
    columns = ["tags.detector", "params.loss.gamma"]
    through = store.read(sweep.names.experiment, columns).sort_values(["run_uuid", "step"]).reset_index(drop=True)
    direct = Store(tmp_path / "runs", database).read(sweep.names.experiment, columns)
    direct = direct.sort_values(["run_uuid", "step"]).reset_index(drop=True)[list(through.columns)]
    assert len(through) == 2 * 4
    assert through.equals(direct)
