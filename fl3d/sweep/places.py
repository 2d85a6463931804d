"""Where a sweep writes: looked at before anything is made, not when all is trained."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from fl3d.config.settings import Settings
from fl3d.core.errors import FULL, ConfigError, Unwritable
from fl3d.core.files import ROOM, check_access, check_writable
from fl3d.runs.layout import StoreFolder
from fl3d.store.opening import open_store
from fl3d.sweep.prepare import is_prepared

RESULTS = ("scores", "tables", "figures")  # folders of a results folder


def check_places(settings: Settings) -> None:
    """Refuse a sweep whose store, results or simulated frames cannot be written.

    Raises:
        ConfigError: naming the key, the place, and why.
    """
    for key, folder, room in _written(settings):
        try:
            check_writable(folder, room)
        except Unwritable as error:
            raise _refused(key, Path(error.filename), error) from None
    file = open_store(settings.store.root, settings.store.uri).file
    if file is not None and file.exists():
        try:
            check_access(file, os.R_OK | os.W_OK)
        except OSError as error:
            raise _refused(
                "store.uri" if settings.store.uri else "store.root", file, error
            ) from None


def _written(settings: Settings) -> Iterator[tuple[str, Path, int]]:
    """Folders that a sweep writes to: the key that names each, and the bytes that it should take."""
    layout = StoreFolder(settings.store.root)
    yield "store.root", layout.root, ROOM
    yield "results", settings.results_folder, ROOM
    inner = [("store.root", folder) for folder in (layout.stages, layout.plans, layout.checks)]
    inner += [("results", settings.results_folder / name) for name in RESULTS]
    yield from ((key, folder, 1) for key, folder in inner if folder.exists())
    data = settings.data
    if data.root is not None and not is_prepared(data):
        yield "data.root", data.root, ROOM


def _refused(key: str, place: Path, error: OSError) -> ConfigError:
    hint = f"make room, or give {key}=FOLDER" if error.errno in FULL else f"give {key}=FOLDER"
    hint += " of another disk" if error.errno in FULL else ", one that can be"
    return ConfigError(f"{key}: {place} cannot be written ({error.strerror}); {hint}")
