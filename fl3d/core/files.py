"""Files are written, then renamed: whatever is there is whole."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable
from pathlib import Path

TEMPORARY = ".*.tmp"  # fits the temporary files of ``write_atomically``
OLD_SECONDS = 3600.0  # a temporary file of this age belongs to a process that was killed


def write_atomically(path: Path, write: Callable[[Path], object], flush: bool = True) -> None:
    """Let ``write`` fill a temporary file beside ``path``, flush it to disk and rename it.

    Args:
        path: where the file shall appear; missing folders are made.
        write: receives the temporary path.
        flush: to the disk before the renaming; without it a machine that loses its power may keep an empty file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.tmp")
    try:
        write(temporary)
        if flush:
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def is_old_temporary(path: Path) -> bool:
    """Whether a temporary file is of a process that was killed."""
    try:
        return time.time() - path.stat().st_mtime > OLD_SECONDS
    except FileNotFoundError:
        return False  # renamed just now


def remove_old_temporaries(folder: Path) -> None:
    """Remove what killed processes have left in a folder that nothing else tidies."""
    for path in folder.rglob(TEMPORARY):
        if is_old_temporary(path):
            path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
