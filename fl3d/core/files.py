"""Files are written, then renamed: whatever is there is whole."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
import uuid
from collections.abc import Callable
from pathlib import Path

from fl3d.core.errors import Unwritable

# Bytes: the smallest network's checkpoint has 2.1 MB, and is written beside the one before.
ROOM = 4 << 20
TEMPORARY = ".*.tmp"  # fits the temporary files of ``write_atomically``
OLD_SECONDS = 3600.0  # a temporary file of this age belongs to a process that was killed


def write_atomically(path: Path, write: Callable[[Path], object], flush: bool = True) -> None:
    """Let ``write`` fill a temporary file beside ``path``, flush it to disk and rename it.

    Args:
        path: where the file shall appear; missing folders are made.
        write: receives the temporary path.
        flush: to the disk before the renaming; without it a machine that loses its power may keep an empty file.

    Raises:
        Unwritable: the disk is full, read-only or somebody else's; what was there before is as it was.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_and_rename(path, write, flush)
    except OSError as error:
        raise _about(path, error) from error


def _about(path: Path, error: OSError) -> Unwritable:
    """What went wrong, about the file that was wanted instead of the temporary one."""
    reason = error.strerror or str(error)
    return Unwritable(error.errno, reason, str(path))


def _write_and_rename(path: Path, write: Callable[[Path], object], flush: bool) -> None:
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.tmp")
    try:
        write(temporary)
        if flush:
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):  # the disk that refused it may refuse this too
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


def swap_folder(made: Path, place: Path) -> None:
    """Put a folder that was made in the place of another, which is removed; beside each other on one disk.

    Args:
        made: whole; it is moved.
        place: where it belongs, with what is there now or nothing.

    Raises:
        Unwritable: it cannot be moved; what was there is there again.
    """
    old = place.with_name(f".old-{place.name}")
    try:
        if (
            not place.exists() and old.exists()
        ):  # of a process that was killed between two renamings
            old.rename(place)
        shutil.rmtree(old, ignore_errors=True)
        if place.exists():
            place.rename(old)
        made.rename(place)
    except OSError as error:
        if not place.exists() and old.exists():
            old.rename(place)
        raise _about(place, error) from error
    shutil.rmtree(old, ignore_errors=True)


def check_access(path: Path, mode: int) -> None:
    """Ask the system whether a file may be used, without opening it.

    A process that closes any descriptor of a file gives up all of its locks on it. SQLite has its own in mind: another
    process then takes itself for the last that is connected, and deletes what was written last. So a database is never
    opened by hand (https://sqlite.org/howtocorrupt.html, 2.2).

    Args:
        path: of the file.
        mode: ``os.R_OK``, ``os.W_OK`` or both.

    Raises:
        OSError: it may not, with the reason as far as the system tells it.
    """
    number = None
    if not path.exists():
        number = errno.ENOENT
    elif path.is_dir():
        number = errno.EISDIR
    elif not os.access(path, mode):
        is_read_only = mode & os.W_OK and os.statvfs(path).f_flag & os.ST_RDONLY
        number = errno.EROFS if is_read_only else errno.EACCES
    if number is not None:
        raise OSError(number, os.strerror(number), str(path))


def check_writable(folder: Path, room: int = 1) -> None:
    """Write a file into a folder, or into where it will be made, and delete it again.

    Args:
        folder: need not be there; nothing is left behind.
        room: bytes that are written.

    Raises:
        Unwritable: it cannot be, with the place at fault.
    """
    place = folder.absolute()
    while not os.path.lexists(place):
        place = place.parent
    if not place.is_dir():
        raise Unwritable(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(place))
    probe = place / f".{uuid.uuid4().hex[:12]}.tmp"
    try:
        write_atomically(probe, lambda temporary: temporary.write_bytes(b"\0" * room))
    except Unwritable as error:
        raise Unwritable(error.errno, error.strerror, str(place)) from None
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)
