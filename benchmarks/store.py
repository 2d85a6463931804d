"""From a large store to a finished table: fl3d's reading beside MLflow's own calls.

    python benchmarks/store.py [--trials 1000] [--checkpoints 60]

A store of TRIALS runs with CHECKPOINTS steps of 18 APs each is written straight into MLflow's
tables, with the sweep's plan. Then the sweep is opened, as every command opens it, and its tables, II
to IV, are made; beside it `mlflow.search_runs` and `get_metric_history`, timed on 20 runs and
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

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.config.settings import Settings, read_settings
from fl3d.core.nested import leaves
from fl3d.core.records import Config
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from fl3d.papers.tables import make_tables
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import open_sweep
from fl3d.runs.plans import FrozenPlan, FrozenTrial, write_plan
from fl3d.runs.spec import write_done
from fl3d.store.mlflow.tracking import PROTOCOL_TAG, STORE_TAG, TRIAL_TAG, MlflowStore
from fl3d.sweep.identity import result_config

APS = [
    f"ap_{metric}{average}/{level}"
    for metric in METRICS
    for average in ("", "_r40")
    for level in DIFFICULTIES
]
GAMMAS = (0, 0.1, 0.2, 0.5, 1, 2, 5)
SAMPLED = 20  # runs that MLflow's own calls are timed on
TABLES = 4  # II, III, IV, and IV of the last stage alone
PARAMS = 80  # of each run, as fl3d logs them


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--checkpoints", type=int, default=60)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seconds = 0.0
        for share in (2, 1):
            root = Path(folder) / str(share)
            config = compose_config(
                ["+sweep=gamma", "profile=quick", f"store.root={root}", f"results={root}"]
            )
            settings = read_settings(config)
            store = MlflowStore(root)
            store.open()
            trials = make_trials(config, arguments.trials // share)
            plan(settings, trials)
            fill(store, settings, trials, arguments.checkpoints)
            half, seconds = seconds, min(table(settings) for _ in range(3))
            values = arguments.trials // share * arguments.checkpoints * len(APS)
            print(f"fl3d: {values} values to {TABLES} tables in {seconds:.2f} s", flush=True)
        own = theirs(store, settings) * arguments.trials / SAMPLED
        print(
            f"mlflow.search_runs + get_metric_history: {own:.0f} s (from {SAMPLED} runs), "
            f"{own / seconds:.0f} x"
        )
    tell(
        "store",
        {"tables s": seconds, "half as many s": half, "MLflow's calls / fl3d": own / seconds},
    )


def table(settings: Settings) -> float:
    started = time.perf_counter()
    sweep = open_sweep(settings)
    tables = make_tables(sweep, lambda table: [sweep])
    assert len(tables) == TABLES
    assert len(tables[0].rows) == len(GAMMAS)
    return time.perf_counter() - started


def theirs(store: MlflowStore, settings: Settings) -> float:
    started = time.perf_counter()
    experiment = store.client.get_experiment_by_name(settings.experiment).experiment_id
    for run in store.client.search_runs([experiment], max_results=SAMPLED):
        for key in APS:
            store.client.get_metric_history(run.info.run_id, key)
    return time.perf_counter() - started


def make_trials(config: Config, count: int) -> list[FrozenTrial]:
    """Trials of two detectors, each gamma and many seeds, with a whole config each."""
    common = dict(leaves(result_config(config)))
    trials = []
    for number in range(count):
        detector = ("3D-FCN", "VoxelNet")[number % 2]
        gamma = GAMMAS[number // 2 % len(GAMMAS)]
        seed = number // (2 * len(GAMMAS))
        values = {"detector": detector, "loss.gamma": gamma, "seed": seed}
        trials.append(
            FrozenTrial(
                key=f"trial-{number}",
                overrides=tuple(f"{key}={value}" for key, value in values.items()),
                values=values,
                config=common | values,
                stages=(f"trial-{number}",),
                first_own_step=0,
                detector=detector,
                group=detector,
                level=f"{gamma:g}",
                seed=seed,
            )
        )
    return trials


def plan(settings: Settings, trials: list[FrozenTrial]) -> None:
    """Leave what a sweep that is done leaves beside the store."""
    layout = StoreFolder(settings.store.root)
    frozen = FrozenPlan(factor=("loss.gamma",), baseline="0", trials=tuple(trials))
    write_plan(layout.plan(settings.experiment), frozen)
    for trial in trials:
        write_done(layout.run(trial.key), {})


def fill(
    store: MlflowStore, settings: Settings, trials: list[FrozenTrial], n_checkpoints: int
) -> None:
    """Write runs into MLflow's tables, as its client would over half an hour."""
    experiment = store.experiment(settings.experiment, "")
    connection = sqlite3.connect(store.root / "mlflow.db")
    rng = np.random.default_rng(0)
    for trial in trials:
        run = uuid.UUID(bytes=rng.bytes(16)).hex
        connection.execute(
            "INSERT INTO runs (run_uuid, name, source_type, user_id, status, start_time, "
            "lifecycle_stage, experiment_id) "
            "VALUES (?, ?, 'LOCAL', 'user', 'FINISHED', 0, 'active', ?)",
            (run, trial.key, experiment),
        )
        tags = {STORE_TAG: store.id, TRIAL_TAG: trial.key, PROTOCOL_TAG: settings.protocol.id}
        tags |= {f"other.{i}": "x" for i in range(10)}
        params = {f"other.{i}": i for i in range(PARAMS)}
        connection.executemany(
            "INSERT INTO tags VALUES (?, ?, ?)", [(k, v, run) for k, v in tags.items()]
        )
        connection.executemany(
            "INSERT INTO params VALUES (?, ?, ?)", [(k, str(v), run) for k, v in params.items()]
        )
        rows = [
            (key, float(rng.uniform(0, 100)), step, step, run)
            for key in APS
            for step in range(1, n_checkpoints + 1)
        ]
        rows += [("epoch", float(step), step, step, run) for step in range(1, n_checkpoints + 1)]
        columns = "(key, value, timestamp, step, run_uuid, is_nan)"
        insert = f"INSERT INTO {{}} {columns} VALUES (?, ?, ?, ?, ?, 0)"
        connection.executemany(insert.format("metrics"), rows)
        connection.executemany(
            insert.format("latest_metrics"), [row for row in rows if row[2] == n_checkpoints]
        )
    connection.commit()
    connection.close()


if __name__ == "__main__":
    main()
