"""The store on a real PostgreSQL and on an MLflow server: many writers, and outages.

`make test-postgres` runs this.
"""

import multiprocessing as mp
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import sqlalchemy as sa

from fl3d.core.errors import StoreDown
from fl3d.store.base import RunStatus, Scored
from fl3d.store.mlflow.connection import database_url
from fl3d.store.mlflow.tracking import MlflowStore
from fl3d.sweep.launchers.local import LocalLauncher
from tests.support import run_small, small_sweep

SCRIPT = Path(__file__).resolve().parent / "services" / "postgres.sh"
WRITERS = 8
TRIALS = 4
STEPS = 30
METRICS = 18
POINTS = [["detector=voxelnet", f"loss.gamma={g}"] for g in (0, 2)]


def postgres(verb: str) -> str:
    folder = os.environ["FL3D_TEST_POSTGRES"]
    return subprocess.run(
        [SCRIPT, verb, folder], capture_output=True, text=True, check=True
    ).stdout.strip()


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
    command += [
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
        "--artifacts-destination",
        str(tmp_path / "artifacts"),
    ]
    environment = {**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    with (tmp_path / "server.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdout=log, stderr=log, env=environment, start_new_session=True
        )
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
    store = MlflowStore(root, uri)
    store.open()
    experiment = store.experiment("shared", "")
    tags = {"detector": "VoxelNet"}
    for trial in range(TRIALS):
        key = f"trial-{number}-{trial}"
        run = store.run(experiment, key, "paper", "name", tags, {"a": 1})
        for step in range(STEPS):
            scored = Scored(step, 1_000 + step, {f"ap_{m}": m + step / 7 for m in range(METRICS)})
            store.log(run, scored)
            store.log(run, scored)
        store.end(run, RunStatus.DONE)


def test_the_artifacts_of_a_store_that_was_moved_are_found(database: str, tmp_path: Path) -> None:
    """MLflow keeps their absolute paths in the database. Two stores are open in one process."""
    before = MlflowStore(tmp_path / "before", database)
    before.open()
    run = before.run(before.experiment("moved", ""), "trial-a", "paper", "a", {}, {})
    (tmp_path / "table.md").write_text("| a |")
    before.log_files(run, [tmp_path / "table.md"], "tables")
    after = MlflowStore(before.root.rename(tmp_path / "after"), database)
    after.open()
    folder = after.root / "artifacts" / "moved" / run / "artifacts"
    assert rows(database, "SELECT artifact_uri FROM runs") == [(folder.as_uri(),)]
    found = after.client.download_artifacts(run, "tables/table.md")
    assert Path(found).read_text() == "| a |"


def test_eight_writers_lose_and_double_nothing(database: str, tmp_path: Path) -> None:
    """They start together on an empty database, as the tasks of a cluster do."""
    context = mp.get_context("spawn")
    writers = [
        context.Process(target=write, args=(tmp_path / str(number), database, number))
        for number in range(WRITERS)
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(timeout=300)
    assert [writer.exitcode for writer in writers] == [0] * WRITERS
    scores = WRITERS * TRIALS * STEPS * METRICS
    assert rows(database, "SELECT COUNT(*) FROM metrics") == [(scores,)]
    done = "SELECT COUNT(*) FROM runs WHERE status = 'FINISHED'"
    assert rows(database, done) == [(WRITERS * TRIALS,)]
    frame = MlflowStore(tmp_path / "3", database).read("shared")
    assert set(frame["trial"]) == {f"trial-3-{trial}" for trial in range(TRIALS)}  # its own
    assert len(frame) == TRIALS * STEPS
    assert frame["ap_5"].tolist() == [5 + step / 7 for _ in range(TRIALS) for step in range(STEPS)]


def test_a_sweep_waits_for_a_store_that_is_down(
    server: str, database: str, simulated: Path, tmp_path: Path
) -> None:
    """PostgreSQL is stopped while a sweep trains, and started later: each score is there, once."""
    common = (f"store.uri={database}", "schedule.stages.warmup.epochs=20")
    sweep = small_sweep(simulated, tmp_path, POINTS, *common)
    folder = sweep.layout.run(sweep.plan.trials[0].stages[0])
    outage: list[int] = []

    def stop_and_resume() -> None:
        while len(folder.steps()) < 3:
            time.sleep(0.05)
        postgres("stop")
        outage.append(len(folder.steps()))
        time.sleep(25)
        outage.append(len(folder.steps()))
        postgres("resume")

    thread = threading.Thread(target=stop_and_resume)
    thread.start()
    store = MlflowStore(sweep.settings.store.root, database)
    ran = run_small(sweep, LocalLauncher(1), store)
    thread.join()
    assert len(ran.outcome.trained) == 3
    assert outage[1] > outage[0], "training stood still during the outage"
    query = (
        "SELECT run_uuid, step, COUNT(*) FROM metrics WHERE key = 'ap_3d/moderate' "
        "GROUP BY run_uuid, step"
    )
    counts = rows(database, query)
    assert len(counts) == 2 * 22
    assert {count for _, _, count in counts} == {1}
    assert rows(database, "SELECT DISTINCT status FROM runs") == [("FINISHED",)]


def test_a_store_that_is_down_from_the_start_is_named(tmp_path: Path) -> None:
    pytest.importorskip("psycopg2", reason="make test-postgres installs it")
    with pytest.raises(StoreDown, match="connection to server"):
        MlflowStore(tmp_path, "postgresql://postgres@127.0.0.1:1/none").open()


def test_a_sweep_through_an_mlflow_server(
    mlflow_server: str, database: str, simulated: Path, tmp_path: Path
) -> None:
    """What the server gives back is what lies in its database."""
    store = MlflowStore(tmp_path / "runs", mlflow_server)
    deadline = time.monotonic() + 120
    while True:
        try:
            store.open()
            break
        except StoreDown:
            assert time.monotonic() < deadline
            time.sleep(1)
    sweep = small_sweep(simulated, tmp_path, POINTS, f"store.uri={mlflow_server}")
    assert len(run_small(sweep, store=store).outcome.trained) == 3
    experiment = sweep.settings.experiment
    through = in_order(store.read(experiment))
    direct = in_order(MlflowStore(tmp_path / "runs", database).read(experiment))
    assert len(through) == 2 * 4
    assert through.equals(direct[list(through.columns)])


def in_order(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.sort_values(["run", "step"]).reset_index(drop=True)
