"""MLflow's user interface over a store."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path

from fl3d.core.errors import ConfigError, StoreError
from fl3d.store.mlflow.moved import ARTIFACTS
from fl3d.store.mlflow.server import serve
from fl3d.store.mlflow.tracking import MlflowStore

HOST = "127.0.0.1"  # MLflow's server asks for no password: nobody else shall reach it
PORT = 5000  # MLflow's own
NEXT_PORTS = range(PORT + 1, PORT + 100)  # tried in this order, so that links mostly stay the same
PORTS = range(1, 65536)


def browse(root: Path, uri: str | None, port: int | None) -> None:
    """Print links to all sweeps of a store, and serve it until Ctrl-C, in this process.

    A store that is a server serves itself: only the links are printed.

    Args:
        root: of the store.
        uri: of another store, see ``MlflowStore``; None: the default one below ``root``.
        port: to serve at; None: 5000, or another where that is in use.

    Raises:
        ConfigError: the port cannot be had.
        StoreError: there is no store yet.
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
    with free_port() if port is None else take_port(port) as listening:
        own = int(listening.getsockname()[1])
        if port is None and own != PORT:
            print(f"Port {PORT} is in use; this is port {own}.")
        print_links(store, f"http://{HOST}:{own}")
        print("Ctrl-C ends it.", flush=True)
        serve(store.uri, store.root / ARTIFACTS, listening)


def take_port(port: int) -> socket.socket:
    """A socket that is bound to a port.

    Raises:
        ConfigError: it is in use, kept for others, or none; naming one that is free.
    """
    if port not in PORTS:
        raise ConfigError(f"--port {port}: a port is a number from 1 to {PORTS[-1]}")
    try:
        return _bound(port)
    except OSError as error:
        why = "in use" if error.errno == errno.EADDRINUSE else os.strerror(error.errno or 0)
        with free_port() as other:
            free = other.getsockname()[1]
        raise ConfigError(f"--port {port}: {why}. Give another, such as --port {free}") from None


def free_port() -> socket.socket:
    """A socket that is bound to MLflow's own port, or to the next one that is free."""
    for port in (PORT, *NEXT_PORTS):
        try:
            return _bound(port)
        except OSError:
            continue
    return _bound(0)  # any


def _bound(port: int) -> socket.socket:
    bound = socket.socket()
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((HOST, port))
        bound.listen()  # before this, two could bind to it
    except OSError:
        bound.close()
        raise
    return bound


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
