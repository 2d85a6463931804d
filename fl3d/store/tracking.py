"""Scores in MLflow: one experiment a sweep, one flat run a trial, every score once.

MLflow appends metrics and never overwrites them. A score carries the time its checkpoint was made, so a score that
is logged again is the same row, and the store keeps it once. A store that cannot be reached raises ``StoreDown``;
every call may be made again.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.store.connection import GuardedClient, database_url, outages  # before MLflow: it sets its environment

# isort: split
import mlflow
import pandas as pd
import sqlalchemy as sa
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, LoggedModel, Metric, Param, RunTag
from mlflow.exceptions import MlflowException

from fl3d.errors import StoreError
from fl3d.files import write_text
from fl3d.leases import leased
from fl3d.store.reading import read_database, read_server
from fl3d.store.view import TAG as VIEW_TAG
from fl3d.store.view import link, tag_value

PARAMS_BATCH = 100  # MLflow takes no more parameters in one request
TRIAL_TAG, PROTOCOL_TAG, STORE_TAG = "fl3d.trial", "fl3d.protocol", "fl3d.store"
POSSIBLE = "sqlite:///FILE, postgresql://USER@HOST/NAME, http://HOST:PORT (an MLflow server)"
SCHEMA_LOCK = 0x666C3364  # of PostgreSQL, while MLflow makes its tables


@dataclass(frozen=True)
class Scored:
    """The scores of one checkpoint, on their way into the store.

    Args:
        step: of the checkpoint.
        time_ms: when it was made, milliseconds since 1970.
        values: metrics by name.
    """

    step: int
    time_ms: int
    values: Mapping[str, float]


class Store:
    """An MLflow tracking store.

    Args:
        root: folder of the stages, of the default store and of its artifacts.
        uri: a database (``postgresql://...``, ``sqlite:///...``) or an MLflow server (``http://...``); None:
            ``root/mlflow.db``.

    Raises:
        StoreError: the URI is neither.
    """

    def __init__(self, root: Path, uri: str | None = None) -> None:
        self.root = root.absolute()
        self.uri = database_url(uri or f"sqlite:///{self.root / 'mlflow.db'}")
        if not self.uri.startswith(("sqlite:///", "postgresql", "http://", "https://")):
            raise StoreError(f"store.uri: '{self.uri}' is no store. Possible: {POSSIBLE}")

    @property
    def exists(self) -> bool:
        """Whether the default store has been made; a named one is taken to exist."""
        return not self.uri.startswith("sqlite:") or Path(self.uri.removeprefix("sqlite:///")).exists()

    @property
    def is_file(self) -> bool:
        """Whether it is a SQLite file."""
        return self.uri.startswith("sqlite:")

    @property
    def is_server(self) -> bool:
        """Whether it is an MLflow server."""
        return self.uri.startswith("http")

    @property
    def id(self) -> str:
        """Tells the runs of this root from those of others in a shared store; made at first use."""
        path = self.root / "id"
        if not path.exists():
            own = path.with_name(f".id.{uuid.uuid4().hex}.tmp")
            write_text(own, uuid.uuid4().hex + "\n")
            with contextlib.suppress(FileExistsError):  # another process was first
                os.link(own, path)
            own.unlink()
        return path.read_text().strip()

    def open(self) -> None:
        """Make the store if need be, and a client of it; several processes may do so at once.

        Raises:
            StoreDown: it cannot be reached.
        """
        logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # tracebacks of what is raised anyway
        mlflow.set_tracking_uri(self.uri)
        self.client: Any = GuardedClient(MlflowClient)
        with outages(), self._alone():
            self.client.connect(self.uri)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """One process at a time: several that make MLflow's tables together destroy a SQLite store."""
        if self.uri.startswith("postgresql"):
            with sa.create_engine(self.uri).connect() as connection:
                connection.execute(sa.text(f"SELECT pg_advisory_lock({SCHEMA_LOCK})"))
                yield
        elif self.uri.startswith("sqlite"):
            path = Path(self.uri.removeprefix("sqlite:///"))
            with leased(path.with_name(f".{path.name}.lease")), sa.create_engine(self.uri).connect() as connection:
                connection.execute(sa.text("PRAGMA journal_mode=WAL"))
                yield
        else:
            yield

    def experiment(self, name: str, note: str) -> str:
        """Id of a sweep's experiment, made at first use; ``note`` is shown above its runs, as Markdown."""
        found = self.client.get_experiment_by_name(name)
        if found is None:
            location = None if self.is_server else (self.root / "artifacts" / name).as_uri()
            try:
                return str(self.client.create_experiment(name, location, {"mlflow.note.content": note}))
            except MlflowException as error:
                found = self.client.get_experiment_by_name(name)
                if found is None or error.error_code != "RESOURCE_ALREADY_EXISTS":  # made by another just now
                    raise
        if found.lifecycle_stage == "deleted":
            self.client.restore_experiment(found.experiment_id)
        self.client.set_experiment_tag(found.experiment_id, "mlflow.note.content", note)
        return str(found.experiment_id)

    def views(self) -> dict[str, str]:
        """Name and link, from the UI's root, of each experiment, each with a view of what matters."""
        found = [one for one in self.client.search_experiments() if one.name != "Default"]
        for one in found:
            self.client.set_experiment_tag(one.experiment_id, VIEW_TAG, tag_value())
        return {one.name: link(one.experiment_id) for one in sorted(found, key=lambda one: str(one.name))}

    def run(
        self,
        experiment: str,
        trial: str,
        protocol: str,
        name: str,
        tags: Mapping[str, str],
        params: Mapping[str, object],
    ) -> str:
        """Id of a trial's run, made at first use.

        Args:
            experiment: id.
            trial: its key; with the protocol the run's identity.
            protocol: id.
            name: shown in the UI.
            tags: further ones.
            params: the config, flat; logged once, as MLflow's parameters cannot change.
        """
        identity = {TRIAL_TAG: trial, PROTOCOL_TAG: protocol, STORE_TAG: self.id}
        query = " and ".join(f"tags.`{key}` = '{value}'" for key, value in identity.items())
        found = self.client.search_runs([experiment], query, max_results=1)
        own = {**identity, **tags}
        run = found[0] if found else self.client.create_run(experiment, tags=own, run_name=name)
        # A process that was killed right here leaves a run without some of its parameters.
        items = [Param(key, str(value)) for key, value in params.items() if key not in run.data.params]
        for start in range(0, len(items), PARAMS_BATCH):
            self.client.log_batch(run.info.run_id, params=items[start : start + PARAMS_BATCH], synchronous=True)
        if run.info.status not in ("RUNNING", "FINISHED"):
            self.client.update_run(run.info.run_id, status="RUNNING")
        return str(run.info.run_id)

    def log(
        self, run_id: str, scored: Scored, model: str | None = None, dataset: tuple[str, str] | None = None
    ) -> None:
        """Log one checkpoint's metrics in one transaction, for the run and, if given, for a logged model.

        Args:
            run_id: of the trial.
            scored: step, time and values.
            model: id of a logged model.
            dataset: name and digest of what the model was scored on.
        """
        name, digest = dataset or (None, None)
        metrics = [
            Metric(key, value, scored.time_ms, scored.step, model, name, digest) for key, value in scored.values.items()
        ]
        self.client.log_batch(run_id, metrics=metrics, synchronous=True)

    def logged_steps(self, run_id: str) -> set[int]:
        """Steps whose scores the run holds."""
        return {m.step for m in self.client.get_metric_history(run_id, "ap_3d/moderate")}

    def link_dataset(self, run_id: str, name: str, digest: str, root: Path) -> None:
        """Name the validation frames as the run's dataset."""
        if self.client.get_run(run_id).inputs.dataset_inputs:
            return
        dataset = Dataset(name, digest, "local", json.dumps({"uri": root.absolute().as_uri()}))
        self.client.log_inputs(run_id, [DatasetInput(dataset, [InputTag("mlflow.data.context", "validation")])])

    def log_model(
        self,
        experiment: str,
        run_id: str,
        name: str,
        files: Sequence[Path],
        tags: Mapping[str, str],
        scored: Scored,
        dataset: tuple[str, str],
    ) -> str:
        """A logged model of a run under a name (``last``, ``best``), made at first use.

        Args:
            experiment: id.
            run_id: of the trial.
            name: of the model.
            files: put beside it.
            tags: its checkpoint; a model with other tags, or one that was never finished, is replaced.
            scored: its scores.
            dataset: name and digest of what it was scored on.

        Returns:
            id of the model.
        """
        query = f"source_run_id = '{run_id}' AND name = '{name}'"
        for model in self.client.search_logged_models([experiment], query):
            is_same = all(model.tags.get(k) == v for k, v in tags.items())
            if is_same and str(model.status) == "READY":
                return str(model.model_id)
            self.client.delete_logged_model(model.model_id)
        made: LoggedModel = self.client.create_logged_model(
            experiment, name=name, source_run_id=run_id, tags=dict(tags), model_type="detector"
        )
        for file in files:
            self.client.log_model_artifact(made.model_id, str(file))
        self.log(run_id, scored, str(made.model_id), dataset)
        self.client.finalize_logged_model(made.model_id, "READY")
        return str(made.model_id)

    def log_files(self, run_id: str, files: Iterable[Path], folder: str) -> None:
        """Put files beside a run; those of the same name are overwritten."""
        for file in files:
            self.client.log_artifact(run_id, str(file), folder)

    def set_tags(self, run_id: str, tags: Mapping[str, str]) -> None:
        """Set tags of a run."""
        self.client.log_batch(run_id, tags=[RunTag(k, v) for k, v in tags.items()], synchronous=True)

    def is_finished(self, run_id: str) -> bool:
        """Whether the run was closed as FINISHED."""
        return str(self.client.get_run(run_id).info.status) == "FINISHED"

    def end(self, run_id: str, status: str) -> None:
        """Close a run as FINISHED, FAILED or KILLED, unless it is closed so."""
        if self.client.get_run(run_id).info.status != status:
            self.client.set_terminated(run_id, status)

    def read(self, experiment_name: str, columns: Sequence[str]) -> pd.DataFrame:
        """All scores of this root's runs of a sweep.

        Args:
            experiment_name: of the sweep.
            columns: of the runs, such as ``tags.detector`` or ``params.seed``.

        Returns:
            one row for each run and step: the columns, ``run_uuid``, ``step``, ``epoch`` and every AP. Empty where
            there is no such experiment.

        Raises:
            StoreDown: the store cannot be reached.
        """
        tag = (STORE_TAG, self.id)
        with outages():
            if not self.is_server:
                return read_database(self.uri, experiment_name, tag, columns)
            self.open()
            found = self.client.get_experiment_by_name(experiment_name)
            return read_server(self.client, found.experiment_id, tag, columns) if found else pd.DataFrame()
