"""How a store is reached: its URL, and telling an outage, which will pass, from an error."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

# A server that is down shall be found out in seconds; who waits for it decides when to try again.
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "10")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("DO_NOT_TRACK", "true")

import pandas as pd
import sqlalchemy as sa

from fl3d.core.errors import StoreDown, StoreError
from fl3d.core.extras import install
from fl3d.store.mlflow.condition import damage, shown

if TYPE_CHECKING:
    from mlflow import MlflowClient

PATIENCE = "?connect_timeout=10&keepalives_idle=10&keepalives_interval=5&keepalives_count=3&tcp_user_timeout=20000"
READ_OTHERWISE = re.compile(r"\?|%[0-9A-Fa-f]{2}")  # in a path that is part of a URL
UNWRITABLE = ("database or disk is full", "attempt to write a readonly database")  # SQLite's
CONNECTION_ERRORS = (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError)
DATABASE_ERRORS = (sa.exc.SQLAlchemyError, pd.errors.DatabaseError)
Kinds = tuple[type[Exception], ...]
PASSING = (
    "TEMPORARILY_UNAVAILABLE",
    "DEADLINE_EXCEEDED",
    "RESOURCE_EXHAUSTED",
)  # MLflow's codes of what will pass


def database_url(uri: str) -> str:
    """A URL with the driver that fl3d installs, and with limits on how long a host that has vanished is waited for."""
    if uri.startswith("postgresql://"):  # SQLAlchemy's own choice is another driver
        uri = uri.replace("postgresql://", "postgresql+psycopg2://", 1)
    return uri + PATIENCE if uri.startswith("postgresql+psycopg2://") and "?" not in uri else uri


def check_driver(uri: str) -> None:
    """Refuse PostgreSQL where its driver is not installed.

    Raises:
        StoreError: saying how it is.
    """
    if uri.startswith("postgresql") and importlib.util.find_spec("psycopg2") is None:
        raise StoreError(f"{shown(uri)}: needs PostgreSQL's driver: {install('postgres')}")


def file_url(root: Path) -> str:
    """The URL of a store's own database.

    Raises:
        StoreError: the folder's name has a letter that a URL reads otherwise, and so another file would be opened.
    """
    wrong = READ_OTHERWISE.search(str(root))
    if wrong:
        raise StoreError(
            f"store.root: {root} has '{wrong[0]}' in its name, and MLflow finds its database by a URL, which reads "
            "that otherwise; give a folder without ? and %, or a server's store.uri"
        )
    return f"sqlite:///{root / 'mlflow.db'}"


class GuardedClient:
    """An ``MlflowClient`` whose every call tells an outage from an error."""

    def __init__(self, make: Callable[[str], MlflowClient]) -> None:
        self._make = make
        self._client: Any = None
        self._uri = ""

    def connect(self, uri: str) -> None:
        """Make the client, and with it the store's tables."""
        self._uri = uri
        self._client = self._make(uri)
        self._client.search_experiments(max_results=1)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)

        def call(*arguments: Any, **named: Any) -> Any:
            with outages(self._uri):
                return method(*arguments, **named)

        return call


@contextlib.contextmanager
def outages(uri: str = "") -> Iterator[None]:
    """Raise ``StoreDown`` for what will pass, ``StoreError`` for what will not, and everything else as it is.

    Args:
        uri: of the store, for messages.

    Raises:
        StoreDown: the store cannot be reached now.
        StoreError: its database is damaged, its disk is full or read-only, or it fails otherwise.
    """
    try:
        with _damages(uri):
            yield
    except _of_loaded("requests", "RequestException", CONNECTION_ERRORS) as error:
        _refuse_unwritable(error)
        raise StoreDown(_located(error, uri)) from error
    except _mlflows() as error:
        _refuse_unwritable(error)
        code = getattr(error, "error_code", "")
        unreachable = str(error).startswith("API request to ") and code == "INTERNAL_ERROR"
        if code in PASSING or unreachable or isinstance(error.__cause__, CONNECTION_ERRORS):
            raise StoreDown(_located(error, uri)) from error
        if code == "BAD_REQUEST" and isinstance(error.__cause__, DATABASE_ERRORS):
            raise StoreError(_located(error, uri)) from error
        raise
    except DATABASE_ERRORS as error:
        kind = StoreDown if isinstance(error.__cause__, CONNECTION_ERRORS) else StoreError
        raise kind(_located(error, uri)) from error


def _of_loaded(module: str, name: str, others: Kinds = ()) -> Kinds:
    """Other kinds of errors and a library's; without it where that is not loaded, and so has raised none."""
    loaded = sys.modules.get(module)
    return others if loaded is None else (*others, getattr(loaded, name))


def _mlflows(others: Kinds = ()) -> Kinds:
    return _of_loaded("mlflow.exceptions", "MlflowException", others)


def _refuse_unwritable(error: Exception) -> None:
    """Raise for what waiting does not mend.

    Raises:
        StoreError: saying what does.
    """
    for words in UNWRITABLE:
        if words in str(error):
            raise StoreError(
                f"MLflow's database cannot be written ({words}); what is there is kept: mend that, and the same "
                "command goes on from it"
            ) from error


def make_whole(file: Path) -> None:
    """Make a database that is not there, aside, and put it in place whole; one process at a time.

    MLflow makes its tables by many migrations; a process that is killed between two leaves what none can go on from.
    """
    for left in file.parent.glob(
        f".{file.name}.*.tmp*"
    ):  # by one that was killed, with SQLite's own beside it
        left.unlink()
    if file.exists() and file.stat().st_size:
        return
    aside = file.with_name(f".{file.name}.{uuid.uuid4().hex}.tmp")
    from mlflow import MlflowClient

    MlflowClient(f"sqlite:///{aside}").search_experiments(max_results=1)
    aside.replace(file)


def reading_url(uri: str) -> str:
    """A URL to read a database by; where nobody may write, it is without the files that SQLite keeps beside it."""
    if not uri.startswith("sqlite:///"):
        return uri
    file = Path(uri.removeprefix("sqlite:///")).absolute()
    waiting = file.with_name(
        f"{file.name}-wal"
    )  # what was written last, where a process was killed
    has_all = not waiting.exists() or waiting.stat().st_size == 0
    if os.access(file.parent, os.W_OK) or not has_all:
        return uri
    return f"sqlite:///file:{quote(str(file))}?immutable=1&uri=true"


@contextlib.contextmanager
def _damages(uri: str) -> Iterator[None]:
    try:
        yield
    except _mlflows(DATABASE_ERRORS) as error:
        found = damage(error, uri)
        if found is None:
            raise
        raise found from error


def _located(error: Exception, uri: str) -> str:
    first = str(error).splitlines()[0]
    return f"{shown(uri)}: {first}" if uri else first
