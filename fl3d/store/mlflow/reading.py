"""Read a sweep's scores back as one frame: a few SQL queries, however many runs; from a server, call by call."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pandas as pd
import sqlalchemy as sa

from fl3d.store.base import is_score
from fl3d.store.mlflow.connection import reading_url

SERVER_CALLS = 8  # at once


def artifact_places(uri: str, runs: Sequence[str]) -> dict[str, Path]:
    """Folders of artifacts by run, from MLflow's database; of those that lie in this machine's files.

    Args:
        uri: of the database.
        runs: ids.
    """
    engine = sa.create_engine(reading_url(uri))
    query = f"SELECT run_uuid, artifact_uri FROM runs WHERE run_uuid IN ({_among(runs)})"
    try:
        with engine.connect() as connection:
            found = connection.execute(sa.text(query)).fetchall()
    finally:
        engine.dispose()
    parts = {str(run): urlsplit(place or "") for run, place in found}
    return {run: Path(unquote(one.path)) for run, one in parts.items() if one.scheme == "file"}


def read_database(
    uri: str, experiment: str, tag: tuple[str, str], columns: Sequence[str]
) -> pd.DataFrame:
    """Scores of the runs of an experiment that carry a tag, from MLflow's database.

    The database turns rows into columns: 1000 trials of 60 checkpoints of 18 APs take a second, which half a dozen
    calls for each run would make minutes (``benchmarks/store.py``).

    Args:
        uri: of the database.
        experiment: its name.
        tag: key and value.
        columns: of the runs, such as ``tags.detector`` or ``params.seed``.

    Returns:
        see ``store.base.Store.read``.
    """
    engine = sa.create_engine(reading_url(uri))
    try:
        with engine.connect() as connection:
            bound = {"name": experiment, "k": tag[0], "v": tag[1]}
            rows = connection.execute(sa.text(_RUNS), bound).fetchall()
            runs = pd.DataFrame(rows, columns=["run_uuid"])
            ids = runs["run_uuid"].tolist()
            if not ids:
                return pd.DataFrame()
            scores = _scores(connection, ids)
            for column in columns:
                runs[column] = runs["run_uuid"].map(_values(connection, column, ids))
    finally:
        engine.dispose()
    if scores.empty:
        return scores
    return scores.sort_values(["run_uuid", "step"], ignore_index=True).merge(
        runs, "left", "run_uuid"
    )


_RUNS = (
    "SELECT r.run_uuid FROM runs r JOIN experiments e ON e.experiment_id = r.experiment_id "
    "JOIN tags t ON t.run_uuid = r.run_uuid AND t.key = :k AND t.value = :v "
    "WHERE e.name = :name AND r.lifecycle_stage = 'active'"
)


def _among(ids: Sequence[str]) -> str:
    """A list of run ids for SQL; they are hexadecimal, and drivers limit the number of bound values."""
    return ", ".join(f"'{int(run, 16):032x}'" for run in ids)


def _scores(connection: sa.Connection, ids: Sequence[str]) -> pd.DataFrame:
    among = _among(ids)
    found = connection.execute(
        sa.text(f"SELECT DISTINCT key FROM latest_metrics WHERE run_uuid IN ({among})")
    )
    keys = sorted(key for (key,) in found if is_score(key))
    if not keys:
        return pd.DataFrame()
    bound = {f"k{number}": key for number, key in enumerate(keys)}
    pivot = ", ".join(f"MAX(CASE WHEN key = :{name} THEN value END) AS {name}" for name in bound)
    query = (
        f"SELECT run_uuid, step, {pivot} FROM metrics WHERE run_uuid IN ({among}) "
        f"AND key IN ({', '.join(f':{name}' for name in bound)}) GROUP BY run_uuid, step"
    )
    wide = pd.DataFrame(
        connection.execute(sa.text(query), bound).fetchall(), columns=["run_uuid", "step", *keys]
    )
    return wide.astype(dict.fromkeys(keys, float))


def _values(connection: sa.Connection, column: str, ids: Sequence[str]) -> dict[str, str]:
    table, _, key = column.partition(".")
    assert table in ("tags", "params"), column
    query = f"SELECT run_uuid, value FROM {table} WHERE key = :key AND run_uuid IN ({_among(ids)})"
    return {run: value for run, value in connection.execute(sa.text(query), {"key": key})}


def read_server(
    client: Any, experiment_id: str, tag: tuple[str, str], columns: Sequence[str]
) -> pd.DataFrame:
    """The same from an MLflow server, which has no call for many histories at once.

    Args:
        client: an ``MlflowClient``.
        experiment_id: of the experiment.
        tag: key and value.
        columns: see ``read_database``.
    """
    runs = list(_pages(client, experiment_id, f"tags.`{tag[0]}` = '{tag[1]}'"))
    calls = [(run, key) for run in runs for key in run.data.metrics if is_score(key)]
    with ThreadPoolExecutor(SERVER_CALLS) as pool:
        histories = pool.map(
            lambda call: client.get_metric_history(call[0].info.run_id, call[1]), calls
        )
    rows = [
        {"run_uuid": run.info.run_id, "step": metric.step, "key": key, "value": metric.value}
        for (run, key), history in zip(calls, histories, strict=True)
        for metric in history
    ]
    if not rows:
        return pd.DataFrame()
    wide = pd.DataFrame(rows).pivot_table(
        index=["run_uuid", "step"], columns="key", values="value", aggfunc="max"
    )
    front = []
    for run in runs:
        known = {f"tags.{key}": value for key, value in run.data.tags.items()}
        known |= {f"params.{key}": value for key, value in run.data.params.items()}
        front.append(
            {"run_uuid": run.info.run_id} | {column: known.get(column) for column in columns}
        )
    return wide.reset_index().merge(pd.DataFrame(front), "left", "run_uuid")


def _pages(client: Any, experiment_id: str, query: str) -> Iterable[Any]:
    token = None
    while True:
        page = client.search_runs([experiment_id], query, max_results=1000, page_token=token)
        yield from page
        token = page.token
        if not token:
            return
