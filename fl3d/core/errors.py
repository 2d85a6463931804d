"""Every error that fl3d raises on purpose; each names what is wrong, where, and what was possible.

Fl3dError
├── ConfigError        a key, a value or a sweep file
├── DataError          a file of a dataset: names file, line and field
│   └── DataMissing    a file or folder of it is not there
├── CheckpointError    a checkpoint that is torn, or of another network
├── TrainingError      a stage that cannot continue (loss is not finite)
├── StageFailed        a stage of a sweep ended with an error; carries its traceback
├── Unwritable         a file or folder that cannot be written: the disk is full, read-only, or somebody else's
├── NotInstalled       an extra of fl3d's is not installed
└── StoreError         the store is missing, locked or of another kind
    └── StoreDown      the store cannot be reached now; the same call may go through later
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable
from pathlib import Path

FULL = (errno.ENOSPC, errno.EDQUOT)  # the disk, or one user's part of it
# A disk, or the network to it, that has not answered; the same call may go through later.
FAULTY = (
    errno.EIO,
    errno.ESTALE,
    errno.EAGAIN,
    errno.EBUSY,
    errno.ENOLCK,
    errno.ENOTCONN,
    errno.ETIMEDOUT,
    errno.EHOSTDOWN,
    errno.EREMOTEIO,
)


class ResultsWarning(UserWarning):
    """Labels or results look as if somebody had made a mistake, though numbers come of them."""


class Fl3dError(Exception):
    """Base of all errors that fl3d raises on purpose."""


class ConfigError(Fl3dError):
    """A key, a value or a sweep file that cannot be used."""


class DataError(Fl3dError):
    """A file of a dataset that cannot be used.

    Args:
        message: what is wrong and what was expected.
        file: the file at fault.
        line: its line, counted from 1, for text files.
    """

    def __init__(self, message: str, file: Path | str, line: int | None = None) -> None:
        where = f"{file}:{line}" if line is not None else f"{file}"
        super().__init__(f"{where}: {message}")
        self.file = Path(file)
        self.line = line


class DataMissing(DataError):
    """A file or folder of a dataset that is not there; what is there may be whole."""


class CheckpointError(Fl3dError):
    """A checkpoint that is torn, or that belongs to another network."""


class TrainingError(Fl3dError):
    """A stage that cannot continue."""


class StageFailed(Fl3dError):
    """A stage of a sweep that ended with an error."""


class Unwritable(Fl3dError, OSError):
    """A file or folder that cannot be written; what was there before is as it was.

    Args:
        number: of the system's error.
        reason: in the system's words.
        path: of the file or folder.
    """

    def __init__(self, number: int | None, reason: str | None, path: str) -> None:
        super().__init__(number, reason, path)

    def __str__(self) -> str:
        said = f"{self.filename}: cannot be written ({self.strerror})"
        if self.errno not in FULL:
            return said
        return f"{said}; what is there is kept: make room, and the same command goes on from it"


class NotInstalled(Fl3dError, ImportError):
    """A package that an extra of fl3d's brings; says how to install it."""


class StoreError(Fl3dError):
    """The store is missing, locked or of another kind."""


class StoreDown(StoreError):
    """The store cannot be reached now; the same call may go through later."""


def options(wrong: str, possible: Iterable[str]) -> str:
    """Say what was possible, nearest first: ``Did you mean 'gamma'? Possible: ...``."""
    names = sorted(possible)
    return f"{meant(wrong, names)}Possible: {', '.join(names) or 'nothing'}."


def meant(wrong: str, possible: Iterable[str]) -> str:
    """``Did you mean 'gamma'?`` and a blank, if a name is near enough; else nothing."""
    names = sorted(possible)
    near = [name for name in names if name.lower() == str(wrong).lower()]
    near += difflib.get_close_matches(str(wrong), names, n=1)
    return f"Did you mean '{near[0]}'? " if near else ""
