"""The journal file of a study: whole lines alone are written, and a torn last line is put aside."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from optuna.storages.journal import (
    JournalFileBackend,
    JournalFileSymlinkLock,
    JournalStorage,
)

from fl3d.core.errors import StoreError

# Of an entry, and of what a machine that lost its power leaves where one should be.
BEGINNINGS = (b"{", b"\0")
KEPT = "What its trials trained stays in the store, and is not trained again where a new study proposes it"


class Journal(JournalFileBackend):
    """Optuna's journal file, which a kill or a full disk cannot spoil.

    Optuna appends behind whatever is there: behind a torn line its own would be lost, and the study with it.

    Args:
        path: of the file; it is made.
        say: told what was put aside.
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self.path = path
        self.say = say
        self._own_lock = JournalFileSymlinkLock(str(path))
        super().__init__(str(path), self._own_lock)
        with self._alone():
            _check_lines(path)
            self._put_torn_line_aside()

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Write lines, or none of them.

        Raises:
            StoreError: the file cannot be written.
        """
        text = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs)
        try:
            with self._alone():
                self._put_torn_line_aside()
                self._append(text.encode())
        except OSError as error:
            raise StoreError(f"{self.path}: cannot be written ({error.strerror})") from error

    def _append(self, text: bytes) -> None:
        before = self.path.stat().st_size
        with self.path.open("ab") as file:
            try:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            except BaseException:  # such as a full disk: half a line is worse than none
                os.truncate(self.path, before)
                raise

    @contextlib.contextmanager
    def _alone(self) -> Any:
        """Hold Optuna's own lock: nobody is in the middle of a line."""
        self._own_lock.acquire()
        try:
            yield
        finally:
            self._own_lock.release()

    def _put_torn_line_aside(self) -> None:
        size = self.path.stat().st_size
        last, start = _last_line(self.path, size)
        if size == 0 or _is_entry(last):
            return
        aside = self.path.with_name(f"{self.path.name}.torn")
        with aside.open("ab") as file:
            file.write(last + b"\n")
            file.flush()
            os.fsync(file.fileno())
        os.truncate(self.path, start)
        self.say(
            f"{self.path}: its last line was torn, as by a kill or a full disk; it was put aside into {aside.name}, "
            "and the study goes on without it"
        )


def open_journal(path: Path, say: Callable[[str], None]) -> JournalStorage:
    """The study storage in a journal file.

    Args:
        path: of the file; it and its folders are made.
        say: told what was put aside.

    Raises:
        StoreError: the file is no journal, is damaged, or cannot be read or written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return JournalStorage(Journal(path, say))
    except OSError as error:
        raise StoreError(
            f"{path}: the journal of the study cannot be read or written ({error.strerror})"
        ) from error
    except StoreError:
        raise
    except (
        Exception
    ) as error:  # whatever Optuna meets when it follows lines that do not belong together
        raise StoreError(
            f"{path}: its lines are those of a journal, but do not belong together "
            f"({type(error).__name__}: {error}); {_way_out(path)}"
        ) from error


def _check_lines(path: Path) -> None:
    """Read all lines once; the last may be torn.

    Raises:
        StoreError: naming the first that is none of a journal.
    """
    size = path.stat().st_size
    read = 0
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            read += len(line)
            is_torn = read == size and line.startswith(BEGINNINGS)
            if not is_torn and not _is_entry(line):
                shown = line[:40].decode("ascii", "replace").rstrip()
                raise StoreError(
                    f"{path}:{number}: '{shown}' is no entry of an Optuna journal: the file is damaged, or something "
                    f"else. What follows would depend on it, so nothing is guessed; {_way_out(path)}"
                )


def _way_out(path: Path) -> str:
    return f"give another hydra.sweeper.study_name, or bring back a copy of {path.name} from before. {KEPT}"


def _is_entry(line: bytes) -> bool:
    """Whether a line is a whole one of Optuna's."""
    if not line.endswith(b"\n"):
        return False
    try:
        entry = json.loads(line)
    except ValueError:
        return False
    return isinstance(entry, dict) and {"op_code", "worker_id"} <= set(entry)


def _last_line(path: Path, size: int, step: int = 1 << 16) -> tuple[bytes, int]:
    """The last line of a file, with its ending if it has one, and where it starts."""
    start, found = size, b""
    with path.open("rb") as file:
        while start > 0:
            begin = max(0, start - step)
            file.seek(begin)
            found = file.read(start - begin) + found
            start = begin
            cut = found[:-1].rfind(b"\n")
            if cut >= 0:
                return found[cut + 1 :], start + cut + 1
    return found, 0
