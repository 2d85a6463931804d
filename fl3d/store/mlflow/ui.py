"""MLflow's user interface over a store."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from fl3d.core.errors import ConfigError, StoreError
from fl3d.store.mlflow.tracking import MlflowStore

HOST = "127.0.0.1"  # MLflow's server asks for no password: nobody else shall reach it
PORTS = range(1, 65536)
GRACE_SECONDS = 5.0  # for the server to end by itself


def browse(root: Path, uri: str | None, port: int) -> None:
    """Print links to all sweeps of a store, and serve it until Ctrl-C.

    A store that is a server serves itself: only the links are printed.

    Args:
        root: of the store.
        uri: of another store, see ``MlflowStore``; None: the default one below ``root``.
        port: to serve at.

    Raises:
        ConfigError: the port cannot be had.
        StoreError: there is no store yet, or MLflow's server has failed.
        StoreDown: it cannot be reached.
    """
    store = MlflowStore(root, uri)
    if store.is_server:
        print_links(store, store.uri)
        return
    if not store.exists:
        raise StoreError(
            f"{root}: there is no store yet; run a sweep first, such as: python -m fl3d -m +sweep=gamma"
        )
    check_port(port)
    print_links(store, f"http://{HOST}:{port}")
    print("Ctrl-C ends it.", flush=True)
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", store.uri]
    code = serve([*command, "--host", HOST, "--port", str(port)])
    if code:
        raise StoreError(f"MLflow's server ended with exit code {code}; what it printed says why")


def serve(command: list[str]) -> int:
    """Run a server to its end, or to this process's: then all of its processes end; its exit code."""
    with subprocess.Popen(command, start_new_session=True) as server:
        try:
            return server.wait()
        finally:
            _end(server)


def _end(server: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            server.wait(GRACE_SECONDS)
        os.killpg(server.pid, signal.SIGKILL)


def check_port(port: int) -> None:
    """See that a port can be served at.

    Raises:
        ConfigError: it is in use, kept for others, or none; naming one that is free.
    """
    if port not in PORTS:
        raise ConfigError(f"--port {port}: a port is a number from 1 to {PORTS[-1]}")
    try:
        _bind(port)
    except OSError as error:
        why = "in use" if error.errno == errno.EADDRINUSE else os.strerror(error.errno or 0)
        raise ConfigError(
            f"--port {port}: {why}. Give another, such as --port {_bind(0)}"
        ) from None


def _bind(port: int) -> int:
    """Take a port for a moment, 0: any that is free; which it was."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
        return int(probe.getsockname()[1])


def print_links(store: MlflowStore, address: str) -> None:
    """Print where the store's sweeps are shown.

    Args:
        store: need not be open yet.
        address: of MLflow's server.
    """
    store.open()
    every = f"{address}/#/experiments?workflowType=machine_learning"
    print(f"Open {every}, or the curves of one sweep:")
    for name, view in store.views().items():
        print(f"  {name:32s} {address}/{view}")
