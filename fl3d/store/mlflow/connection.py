"""How a store is reached: its URL, and telling an outage, which will pass, from an error."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# A server that is down shall be found out in seconds; who waits for it decides when to try again.
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "10")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("DO_NOT_TRACK", "true")

import requests
import sqlalchemy as sa
from mlflow import MlflowClient
from mlflow.exceptions import MlflowException

from fl3d.core.errors import StoreDown, StoreError

PATIENCE = "?connect_timeout=10&keepalives_idle=10&keepalives_interval=5&keepalives_count=3&tcp_user_timeout=20000"
CONNECTION_ERRORS = (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError)
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


def file_url(root: Path) -> str:
    """The URL of a store's own database.

    Raises:
        StoreError: the folder's name has a letter that a URL reads otherwise, and so another file would be opened.
    """
    wrong = [letter for letter in "?%" if letter in str(root)]
    if wrong:
        raise StoreError(
            f"store.root: {root} has a '{wrong[0]}' in its name, and MLflow finds its database by a URL, which reads "
            "that otherwise; give a folder without ? and %, or a server's store.uri"
        )
    return f"sqlite:///{root / 'mlflow.db'}"


class GuardedClient:
    """An ``MlflowClient`` whose every call tells an outage from an error."""

    def __init__(self, make: Callable[[str], MlflowClient]) -> None:
        self._make = make
        self._client: Any = None

    def connect(self, uri: str) -> None:
        """Make the client, and with it the store's tables."""
        self._client = self._make(uri)
        self._client.search_experiments(max_results=1)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)

        def call(*arguments: Any, **named: Any) -> Any:
            with outages():
                return method(*arguments, **named)

        return call


@contextlib.contextmanager
def outages() -> Iterator[None]:
    """Raise ``StoreDown`` for what will pass; everything else as it is.

    Raises:
        StoreDown: the store cannot be reached now.
    """
    try:
        yield
    except (*CONNECTION_ERRORS, requests.RequestException) as error:
        raise StoreDown(str(error).splitlines()[0]) from error
    except MlflowException as error:
        unreachable = (
            str(error).startswith("API request to ") and error.error_code == "INTERNAL_ERROR"
        )
        if (
            error.error_code in PASSING
            or unreachable
            or isinstance(error.__cause__, CONNECTION_ERRORS)
        ):
            raise StoreDown(str(error).splitlines()[0]) from error
        raise
