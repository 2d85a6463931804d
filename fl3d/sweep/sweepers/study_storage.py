"""Where a study is kept."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import optuna
import sqlalchemy as sa
from optuna.storages import BaseStorage, RDBStorage

from fl3d.core.errors import StoreError
from fl3d.core.leases import leased
from fl3d.runs.layout import StoreFolder
from fl3d.store.mlflow.address import Address
from fl3d.store.mlflow.connection import database_url
from fl3d.sweep.sweepers.journal import open_journal

WHERE = "hydra.sweeper.storage"


def open_storage(
    url: str | None,
    root: Path,
    store_uri: str | None,
    name: str,
    say: Callable[[str], None] = print,
) -> BaseStorage:
    """Where a study is kept: a journal file below the store's root, or a database of its own.

    Args:
        url: of a database; None: a journal file.
        root: of the store.
        store_uri: of the store's scores.
        name: of the study.
        say: told what was mended.

    Raises:
        StoreError: it is MLflow's database: both tools keep a table ``alembic_version``; or it is damaged, of another
            version, or cannot be reached.
    """
    if url is None:
        with experimental():
            return open_journal(StoreFolder(root.absolute()).study(name), say)
    if database_url(url) == Address(root, store_uri).uri:
        raise StoreError(f"{WHERE}: {url} is MLflow's database; Optuna needs one of its own")
    return _open_database(url)


def _open_database(url: str) -> BaseStorage:
    shown = _without_password(url)
    try:
        return RDBStorage(database_url(url))
    except RuntimeError as error:  # Optuna's word for another version
        raise StoreError(
            f"{WHERE}: {shown} was made by another version of Optuna ({_first_line(error)}). Nothing was changed: copy "
            f"it, then 'optuna storage upgrade --storage {shown}', or give another database"
        ) from error
    except sa.exc.OperationalError as error:
        raise StoreError(f"{WHERE}: {shown} cannot be opened: {_first_line(error.orig)}") from error
    except sa.exc.DatabaseError as error:
        raise StoreError(
            f"{WHERE}: {shown} is damaged, or no database: {_first_line(error.orig)}. Nothing was changed: bring back "
            "a copy of it, or give another one"
        ) from error
    except Exception as error:  # a URL that cannot be read, or whose driver is not installed
        raise StoreError(
            f"{WHERE}: {shown}: {_first_line(error)}. Possible: postgresql://USER@HOST/NAME, sqlite:///FILE, or null "
            "for a journal file below store.root"
        ) from error


def _without_password(url: str) -> str:
    try:
        return sa.engine.make_url(url).render_as_string(hide_password=True)
    except sa.exc.ArgumentError:
        return url


def _first_line(error: object) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")


@contextlib.contextmanager
def alone(root: Path, name: str) -> Iterator[None]:
    """One process at a time opens a study: what it was begun with and what waits in it is written once."""
    with leased(StoreFolder(root.absolute()).study_lease(name)):
        yield


@contextlib.contextmanager
def reached(name: str) -> Iterator[None]:
    """Say in a sentence what keeps an open study from being read or written.

    Raises:
        StoreError: its database has gone or refuses, or its journal has vanished.
    """
    try:
        yield
    except (optuna.exceptions.StorageInternalError, sa.exc.SQLAlchemyError, OSError) as error:
        cause = error.__cause__ or error
        raise StoreError(
            f"the study '{name}' is kept where it cannot be reached now: {_first_line(cause)}. What is trained stays; "
            "the same command goes on"
        ) from error


@contextlib.contextmanager
def experimental() -> Iterator[None]:
    """Without Optuna's warnings that a class may change: its version is pinned."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield
