"""MLflow's user interface over a store."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from fl3d.core.errors import StoreError
from fl3d.store.mlflow.tracking import MlflowStore

HOST = "127.0.0.1"  # MLflow's server asks for no password: nobody else shall reach it


def browse(root: Path, uri: str | None, port: int) -> None:
    """Print links to all sweeps of a store, and serve it until Ctrl-C.

    A store that is a server serves itself: only the links are printed.

    Args:
        root: of the store.
        uri: of another store, see ``MlflowStore``; None: the default one below ``root``.
        port: to serve at.

    Raises:
        StoreError: there is no store yet.
        StoreDown: it cannot be reached.
    """
    store = MlflowStore(root, uri)
    if store.is_server:
        print_links(store, store.uri)
        return
    if not store.exists:
        raise StoreError(
            f"{root}: there is no store yet; run a sweep first, such as: make sweep-gamma"
        )
    print_links(store, f"http://{HOST}:{port}")
    print("Ctrl-C ends it.", flush=True)
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", store.uri]
    subprocess.run([*command, "--host", HOST, "--port", str(port)], check=False)


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
