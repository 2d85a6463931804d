"""The store in MLflow: one experiment a sweep, one flat run a trial, every score once.

MLflow appends metrics and never overwrites them. A score carries the time its checkpoint was made, so a score that
is logged again is the same row, and the store keeps it once. A store that cannot be reached raises ``StoreDown``;
every call may be made again.

What only reads a database does without MLflow, which takes seconds to load; so it is loaded where it is called.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from fl3d.core.errors import Unwritable
from fl3d.store.base import RunStatus, Scored, Store
from fl3d.store.mlflow.address import Address
from fl3d.store.mlflow.condition import other_version
from fl3d.store.mlflow.connection import (  # sets MLflow's environment, which is loaded later
    GuardedClient,
    outages,
)
from fl3d.store.mlflow.experiments import open_experiment, set_views
from fl3d.store.mlflow.moved import ARTIFACTS, artifact_location
from fl3d.store.mlflow.reading import artifact_places, read_database, read_server

if TYPE_CHECKING:
    from mlflow.entities import LoggedModel

PARAMS_BATCH = 100  # MLflow takes no more parameters in one request
TRIAL_TAG = "fl3d.trial"
PROTOCOL_TAG = "fl3d.protocol"
STORE_TAG = "fl3d.store"
COLUMNS = {f"tags.{TRIAL_TAG}": "trial", f"tags.{PROTOCOL_TAG}": "protocol", "run_uuid": "run"}
RENAMED = {
    "fl3d.commit": "mlflow.source.git.commit"
}  # MLflow's own name: its UI shows it as the source
STATUSES = {
    RunStatus.RUNNING: "RUNNING",
    RunStatus.DONE: "FINISHED",
    RunStatus.FAILED: "FAILED",
    RunStatus.STOPPED: "KILLED",
}


class MlflowStore(Store):
    """An MLflow tracking store.

    Args:
        root: see ``Address``.
        uri: likewise.

    Raises:
        StoreError: likewise.
    """

    def __init__(self, root: Path, uri: str | None = None) -> None:
        self.address = Address(root, uri)
        self.root, self.uri = self.address.root, self.address.uri

    @property
    def exists(self) -> bool:
        """Whether the default store has been made; a named one is taken to exist."""
        return self.address.exists

    @property
    def file(self) -> Path | None:
        """The database, where it is a file."""
        return self.address.file

    @property
    def is_for_one_machine(self) -> bool:
        """SQLite's journal lies in one machine's memory: two that write to it over a shared folder destroy it."""
        return self.address.is_file

    @property
    def is_server(self) -> bool:
        """Whether it is an MLflow server."""
        return self.address.is_server

    def open(self) -> None:
        """Make the store if need be, and a client of it; several processes may do so at once.

        Raises:
            StoreDown: it cannot be reached.
            Unwritable: it is a file in a folder that cannot be written.
            StoreError: it is damaged, another program's, or of another version of MLflow.
        """
        import mlflow
        from alembic.util.exc import CommandError
        from mlflow import MlflowClient
        from mlflow.exceptions import MlflowException

        self.address.check()
        log = logging.getLogger("mlflow.store.db.utils")
        log.setLevel(logging.CRITICAL)  # tracebacks of what is raised anyway
        mlflow.set_tracking_uri(self.uri)
        self.client: Any = GuardedClient(MlflowClient)
        with outages(self.uri), self.address.alone() as connection:
            try:
                self.client.connect(self.uri)
            except (MlflowException, CommandError) as error:
                is_version = isinstance(error, CommandError) or "database schema" in str(error)
                if connection is None or not is_version:
                    raise
                raise other_version(connection, self.uri) from error
            self.address.mend()

    def experiment(self, name: str, note: str) -> str:
        location = None if self.is_server else artifact_location(self.root, name)
        return open_experiment(self.client, name, note, location)

    def views(self) -> dict[str, str]:
        """Name and link, from the UI's root, of each experiment, each with a view of what matters."""
        return set_views(self.client)

    def run(
        self,
        experiment: str,
        trial: str,
        protocol: str,
        name: str,
        tags: Mapping[str, str],
        params: Mapping[str, object],
    ) -> str:
        from mlflow.entities import Param

        identity = {TRIAL_TAG: trial, PROTOCOL_TAG: protocol, STORE_TAG: self.id}
        query = " and ".join(f"tags.`{key}` = '{value}'" for key, value in identity.items())
        found = self.client.search_runs([experiment], query, max_results=1)
        own = {**identity, **_renamed(tags)}
        run = found[0] if found else self.client.create_run(experiment, tags=own, run_name=name)
        # A process that was killed right here leaves a run without some of its parameters.
        items = [
            Param(key, str(value)) for key, value in params.items() if key not in run.data.params
        ]
        for start in range(0, len(items), PARAMS_BATCH):
            self.client.log_batch(
                run.info.run_id, params=items[start : start + PARAMS_BATCH], synchronous=True
            )
        if run.info.status not in ("RUNNING", "FINISHED"):
            self.client.update_run(run.info.run_id, status="RUNNING")
        return str(run.info.run_id)

    def log(self, run: str, scored: Scored) -> None:
        self._log(run, scored)

    def _log(
        self,
        run: str,
        scored: Scored,
        model: str | None = None,
        dataset: tuple[str | None, str | None] = (None, None),
    ) -> None:
        """Log one checkpoint's metrics in one transaction, for the run and, if given, for a logged model."""
        from mlflow.entities import Metric

        metrics = [
            Metric(key, value, scored.time_ms, scored.step, model, *dataset)
            for key, value in scored.values.items()
        ]
        self.client.log_batch(run, metrics=metrics, synchronous=True)

    def logged_steps(self, run: str) -> set[int]:
        return {m.step for m in self.client.get_metric_history(run, "ap_3d/moderate")}

    def link_dataset(self, run: str, name: str, digest: str, root: Path) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        if self.client.get_run(run).inputs.dataset_inputs:
            return
        dataset = Dataset(name, digest, "local", json.dumps({"uri": root.absolute().as_uri()}))
        self.client.log_inputs(
            run, [DatasetInput(dataset, [InputTag("mlflow.data.context", "validation")])]
        )

    def log_model(
        self,
        experiment: str,
        run: str,
        name: str,
        files: Sequence[Path],
        tags: Mapping[str, str],
        scored: Scored,
        dataset: tuple[str, str],
    ) -> str:
        query = f"source_run_id = '{run}' AND name = '{name}'"
        for model in self.client.search_logged_models([experiment], query):
            is_same = all(model.tags.get(k) == v for k, v in tags.items())
            if is_same and str(model.status) == "READY":
                return str(model.model_id)
            self.client.delete_logged_model(model.model_id)
        made: LoggedModel = self.client.create_logged_model(
            experiment, name=name, source_run_id=run, tags=dict(tags), model_type="detector"
        )
        with self._copying():
            for file in files:
                self.client.log_model_artifact(made.model_id, str(file))
        self._log(run, scored, str(made.model_id), dataset)
        self.client.finalize_logged_model(made.model_id, "READY")
        return str(made.model_id)

    def models(self, experiment: str) -> set[tuple[str, str]]:
        found: set[tuple[str, str]] = set()
        token = None
        while True:
            page = self.client.search_logged_models([experiment], page_token=token)
            found |= {
                (str(one.source_run_id), str(one.name))
                for one in page
                if str(one.status) == "READY"
            }
            token = page.token
            if not token:
                return found

    def log_files(self, run: str, files: Iterable[Path], folder: str) -> None:
        with self._copying():
            for file in files:
                self.client.log_artifact(run, str(file), folder)

    def without(self, runs: Iterable[str], file: Path, folder: str) -> list[str]:
        wanted = sorted(set(runs))
        if self.file is None or not self.exists:
            return wanted
        with outages(self.uri):
            places = artifact_places(self.uri, wanted)
        own = self.root / ARTIFACTS
        there = {run: place / folder / file.name for run, place in places.items()}
        content = file.read_bytes()
        return [
            run
            for run in wanted
            if run not in there or not (own in there[run].parents and _holds(there[run], content))
        ]

    @contextlib.contextmanager
    def _copying(self) -> Iterator[None]:
        """Say where files could not be put, which the system's own error often does not.

        Raises:
            Unwritable: the disk is full, read-only or somebody else's.
        """
        try:
            yield
        except OSError as error:
            if error.errno is None:
                raise
            place = error.filename or self.root / ARTIFACTS
            raise Unwritable(error.errno, error.strerror, str(place)) from error

    def set_tags(self, run: str, tags: Mapping[str, str]) -> None:
        from mlflow.entities import RunTag

        every = [RunTag(key, value) for key, value in _renamed(tags).items()]
        self.client.log_batch(run, tags=every, synchronous=True)

    def is_finished(self, run: str) -> bool:
        return str(self.client.get_run(run).info.status) == STATUSES[RunStatus.DONE]

    def end(self, run: str, status: RunStatus) -> None:
        if self.client.get_run(run).info.status != STATUSES[status]:
            self.client.set_terminated(run, STATUSES[status])

    def read(self, experiment_name: str) -> pd.DataFrame:
        if not self.exists:
            return pd.DataFrame()
        self.address.check_readable()
        tag = (STORE_TAG, self.id)
        columns = [column for column in COLUMNS if column.startswith("tags.")]
        with outages(self.uri):
            if not self.is_server:
                found = read_database(self.uri, experiment_name, tag, columns)
            else:
                self.open()
                experiment = self.client.get_experiment_by_name(experiment_name)
                if experiment is None:
                    return pd.DataFrame()
                found = read_server(self.client, experiment.experiment_id, tag, columns)
        return found.rename(columns=COLUMNS)


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:  # a file that cannot be looked at is written again, which says what is wrong
        return False


def _renamed(tags: Mapping[str, str]) -> dict[str, str]:
    return {RENAMED.get(key, key): value for key, value in tags.items()}
