"""MLflow's server within this process.

``mlflow ui`` starts nine processes and more: itself, a supervisor with four workers and their tracker, and what runs
jobs for language models. Browsing a store needs one, and what is one process leaves none behind, whatever ends it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn  # before MLflow's server, which guards itself where it finds this loaded

from fl3d.core.interrupts import HEARD, Interrupted

GRACE_SECONDS = 5  # for answers that are under way, when the server ends


def serve(uri: str, artifacts: Path, listening: socket.socket) -> None:
    """Serve a store until this process is told to end.

    Args:
        uri: of the database.
        artifacts: where an experiment that is made in the browser would keep its files.
        listening: bound, so that nobody else can take the port meanwhile.

    Raises:
        Interrupted: a signal was heard, see ``core.interrupts``.
    """
    app = _application(uri, artifacts)
    config = uvicorn.Config(
        app, lifespan="off", log_level=logging.WARNING, timeout_graceful_shutdown=GRACE_SECONDS
    )
    Server(config).run(sockets=[listening])


class Server(uvicorn.Server):
    """A server that ends as the command does that it runs in: by Ctrl-C, SIGTERM and SIGHUP alike, unless ignored.

    While it runs, a signal must not raise: uvicorn would take that for an error of the answer that it is at, and go on.
    """

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Listen to signals while the server runs.

        Raises:
            Interrupted: one was heard; afterwards, when all connections are closed.
        """
        heard: list[int] = []

        def hear(number: int, frame: FrameType | None) -> None:
            heard.append(number)
            self.force_exit = self.should_exit  # the second time nothing is waited for
            self.should_exit = True

        before = {number: signal.getsignal(number) for number in HEARD}
        taken = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
        for number in taken:
            signal.signal(number, hear)
        try:
            yield
        finally:
            for number in taken:
                signal.signal(number, before[number])
        if heard:
            raise Interrupted(heard[0])


def _application(uri: str, artifacts: Path) -> Any:
    """MLflow's application over a store; it reads its environment when it is loaded."""
    from mlflow.server.constants import ARTIFACT_ROOT_ENV_VAR, BACKEND_STORE_URI_ENV_VAR

    os.environ[BACKEND_STORE_URI_ENV_VAR] = uri
    os.environ[ARTIFACT_ROOT_ENV_VAR] = artifacts.as_uri()
    os.environ["MLFLOW_SERVER_ENABLE_JOB_EXECUTION"] = "false"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what MLflow itself is built on
        from mlflow.server.fastapi_app import app
        from mlflow.server.handlers import initialize_backend_stores

    initialize_backend_stores(uri, uri, artifacts.as_uri())
    return app
