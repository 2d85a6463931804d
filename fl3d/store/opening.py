"""Open the store that a config names."""

from __future__ import annotations

from pathlib import Path

from fl3d.store.base import Store


def open_store(root: Path, uri: str | None = None) -> Store:
    """The store of a root; it is connected to by its own ``open``.

    Args:
        root: folder of run folders, and of the default store.
        uri: of a database or an MLflow server; None: a file below ``root``.

    Raises:
        StoreError: the URI is neither.
    """
    from fl3d.store.mlflow.tracking import (
        MlflowStore,  # half a second, that not every command needs
    )

    return MlflowStore(root, uri)
