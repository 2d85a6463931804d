"""Where a study is kept."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path

import optuna
from optuna.storages import BaseStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalStorage

from fl3d.core.errors import StoreError
from fl3d.runs.layout import StoreFolder
from fl3d.store.mlflow.connection import database_url
from fl3d.store.mlflow.tracking import MlflowStore


def open_storage(url: str | None, root: Path, store_uri: str | None, name: str) -> BaseStorage:
    """Where a study is kept: a journal file below the store's root, or a database of its own.

    Raises:
        StoreError: it is MLflow's database: both tools keep a table ``alembic_version``.
    """
    if url is None:
        path = StoreFolder(root.absolute()).study(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with experimental():
            return JournalStorage(JournalFileBackend(str(path)))
    if database_url(url) == MlflowStore(root, store_uri).uri:
        raise StoreError(
            f"hydra.sweeper.storage: {url} is MLflow's database; Optuna needs one of its own"
        )
    return RDBStorage(database_url(url))


@contextlib.contextmanager
def experimental() -> Iterator[None]:
    """Without Optuna's warnings that a class may change: its version is pinned."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield
