"""The only module that knows MLflow: one experiment a sweep, one flat run a trial, every score once.

MLflow appends metrics and never overwrites them. A score carries the time its checkpoint was made, so a score that
is logged again is the same row, and the store keeps it once.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("DO_NOT_TRACK", "true")

import mlflow
import pandas as pd
import sqlalchemy as sa
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, LoggedModel, Metric, Param, RunTag

from fl3d.errors import StoreError

PARAMS_BATCH = 100  # MLflow takes no more parameters in one request
TRIAL_TAG, PROTOCOL_TAG = "fl3d.trial", "fl3d.protocol"


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
        root: folder of the default store, and of all artifacts.
        uri: a database (``postgresql://...``, ``sqlite:///...``); None: ``root/mlflow.db``.
    """

    def __init__(self, root: Path, uri: str | None = None) -> None:
        self.root = root.absolute()
        self.uri = uri or f"sqlite:///{self.root / 'mlflow.db'}"
        if not self.uri.startswith(("sqlite:", "postgresql", "mysql")):
            raise StoreError(
                f"store.uri: '{self.uri}' is not a database. Possible: sqlite:///FILE, postgresql://HOST/NAME"
            )

    @property
    def exists(self) -> bool:
        """Whether the default store has been made; a named database is taken to exist."""
        return not self.uri.startswith("sqlite:") or Path(self.uri.removeprefix("sqlite:///")).exists()

    def open(self) -> MlflowClient:
        """Make the store if need be, and a client of it. One process does this, before others use it."""
        if self.uri.startswith("sqlite:"):
            path = Path(self.uri.removeprefix("sqlite:///"))
            path.parent.mkdir(parents=True, exist_ok=True)
            with sa.create_engine(self.uri).connect() as connection:
                connection.execute(sa.text("PRAGMA journal_mode=WAL"))
        mlflow.set_tracking_uri(self.uri)
        self.client = MlflowClient(self.uri)
        return self.client

    def experiment(self, name: str, note: str) -> str:
        """Id of a sweep's experiment, made at first use; ``note`` is shown above its runs, as Markdown."""
        found = self.client.get_experiment_by_name(name)
        if found is None:
            location = (self.root / "artifacts" / name).as_uri()
            return str(self.client.create_experiment(name, location, {"mlflow.note.content": note}))
        if found.lifecycle_stage == "deleted":
            self.client.restore_experiment(found.experiment_id)
        self.client.set_experiment_tag(found.experiment_id, "mlflow.note.content", note)
        return str(found.experiment_id)

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
        query = f"tags.`{TRIAL_TAG}` = '{trial}' and tags.`{PROTOCOL_TAG}` = '{protocol}'"
        found = self.client.search_runs([experiment], query, max_results=1)
        own = {TRIAL_TAG: trial, PROTOCOL_TAG: protocol, **tags}
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

    def read(self, experiment_name: str) -> pd.DataFrame:
        """All scores of a sweep.

        Args:
            experiment_name: of the sweep.

        Returns:
            one row for each run and step: ``tags.<key>`` and ``params.<key>`` of the run, ``step``, and a column for
            each metric. Empty where there is no such experiment.
        """
        engine = sa.create_engine(self.uri)
        where = (
            "FROM runs r JOIN experiments e ON e.experiment_id = r.experiment_id "
            "WHERE e.name = :name AND r.lifecycle_stage = 'active'"
        )
        bound = {"name": experiment_name}
        with engine.connect() as connection:
            runs = pd.read_sql(sa.text(f"SELECT r.run_uuid {where}"), connection, params=bound)
            parts = []
            for table in ("tags", "params"):
                query = f"SELECT run_uuid, key, value FROM {table} WHERE run_uuid IN (SELECT r.run_uuid {where})"
                long = pd.read_sql(sa.text(query), connection, params=bound)
                parts.append(long.pivot(index="run_uuid", columns="key", values="value").add_prefix(f"{table}."))
            query = f"SELECT run_uuid, step, key, value FROM metrics WHERE run_uuid IN (SELECT r.run_uuid {where})"
            metrics = pd.read_sql(sa.text(query), connection, params=bound)
        engine.dispose()
        if runs.empty or metrics.empty:
            return pd.DataFrame()
        wide = metrics.pivot_table(index=["run_uuid", "step"], columns="key", values="value", aggfunc="last")
        return wide.reset_index().merge(parts[0], "left", "run_uuid").merge(parts[1], "left", "run_uuid")
