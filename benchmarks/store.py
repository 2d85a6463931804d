"""From a large store to a finished table: fl3d's reading beside MLflow's own calls.

    python benchmarks/store.py [--trials 1000] [--checkpoints 60]

A store of TRIALS runs with CHECKPOINTS steps of 18 APs each is written straight into MLflow's tables. Then its scores
are read and Tables II to IV made of them; beside it `mlflow.search_runs` and `get_metric_history`, timed on 20 runs and
multiplied. Times are beyond imports; the size is halved once to show how the time grows.
"""

from __future__ import annotations

import argparse
import os
import sqlite3
import tempfile
import time
import uuid
from pathlib import Path

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

import numpy as np

from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from fl3d.reports.tables import make_tables
from fl3d.reports.write import NAMED, tidy
from fl3d.store.tracking import STORE_TAG, Store

APS = [f"ap_{metric}{average}/{level}" for metric in METRICS for average in ("", "_r40") for level in DIFFICULTIES]
GAMMAS = (0, 0.1, 0.2, 0.5, 1, 2, 5)
SAMPLED = 20  # runs that MLflow's own calls are timed on
PARAMS = 80  # of each run, as fl3d logs them


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--checkpoints", type=int, default=60)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for share in (2, 1):
            store = Store(Path(folder) / str(share))
            store.open()
            fill(store, arguments.trials // share, arguments.checkpoints)
            seconds = min(table(store) for _ in range(3))
            values = arguments.trials // share * arguments.checkpoints * len(APS)
            print(f"fl3d: {values} values to three tables in {seconds:.2f} s", flush=True)
        own = theirs(store) * arguments.trials / SAMPLED
        print(f"mlflow.search_runs + get_metric_history: {own:.0f} s (from {SAMPLED} runs), {own / seconds:.0f} x")


def table(store: Store) -> float:
    started = time.perf_counter()
    scores = tidy(store.read("gamma", list(NAMED)))
    tables = make_tables(scores)
    assert len(tables) == 3
    assert len(tables[0].rows) == len(GAMMAS)
    return time.perf_counter() - started


def theirs(store: Store) -> float:
    started = time.perf_counter()
    experiment = store.client.get_experiment_by_name("gamma").experiment_id
    for run in store.client.search_runs([experiment], max_results=SAMPLED):
        for key in APS:
            store.client.get_metric_history(run.info.run_id, key)
    return time.perf_counter() - started


def fill(store: Store, n_trials: int, n_checkpoints: int) -> None:
    """Write runs into MLflow's tables, as its client would over half an hour."""
    experiment = store.experiment("gamma", "")
    connection = sqlite3.connect(store.root / "mlflow.db")
    rng = np.random.default_rng(0)
    for number in range(n_trials):
        run = uuid.UUID(bytes=rng.bytes(16)).hex
        detector = ("3D-FCN", "VoxelNet")[number % 2]
        gamma, seed = GAMMAS[number // 2 % len(GAMMAS)], number // (2 * len(GAMMAS))
        connection.execute(
            "INSERT INTO runs (run_uuid, name, source_type, user_id, status, start_time, lifecycle_stage, "
            "experiment_id) VALUES (?, ?, 'LOCAL', 'user', 'FINISHED', 0, 'active', ?)",
            (run, f"run {number}", experiment),
        )
        tags = {STORE_TAG: store.id, "fl3d.trial": f"trial-{number}", "fl3d.protocol": "paper", "detector": detector}
        tags |= {"fl3d.first_own_step": str(n_checkpoints // 2)} | {f"other.{i}": "x" for i in range(10)}
        params = {
            "seed": seed,
            "optimizer.lr": 0.01,
            "loss.gamma": gamma,
            "loss.alpha": 1,
            "loss.beta": 5,
            "loss.eta": 10,
        }
        params |= {f"other.{i}": i for i in range(PARAMS)}
        connection.executemany("INSERT INTO tags VALUES (?, ?, ?)", [(k, v, run) for k, v in tags.items()])
        connection.executemany("INSERT INTO params VALUES (?, ?, ?)", [(k, str(v), run) for k, v in params.items()])
        rows = [
            (key, float(rng.uniform(0, 100)), step, step, run) for key in APS for step in range(1, n_checkpoints + 1)
        ]
        rows += [("epoch", float(step), step, step, run) for step in range(1, n_checkpoints + 1)]
        insert = "INSERT INTO {} (key, value, timestamp, step, run_uuid, is_nan) VALUES (?, ?, ?, ?, ?, 0)"
        connection.executemany(insert.format("metrics"), rows)
        connection.executemany(insert.format("latest_metrics"), [row for row in rows if row[2] == n_checkpoints])
    connection.commit()
    connection.close()


if __name__ == "__main__":
    main()
