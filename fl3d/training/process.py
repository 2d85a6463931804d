"""A command that runs under a guard: start it, see whether it runs, end it, and what its earlier starts came to."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from fl3d.core.errors import TrainingError
from fl3d.training import guard

TAIL = 20  # lines of its output in an error
TAIL_BYTES = 20000
POLL_SECONDS = 0.2


@dataclass(frozen=True, kw_only=True)
class Exit:
    """What a start of a command came to.

    Args:
        started: seconds since 1970.
        ended: likewise.
        code: of its exit; negative: the signal that ended it.
        by_fl3d: whether fl3d ended it, or went away itself.
    """

    started: float
    ended: float
    code: int
    by_fl3d: bool

    def __str__(self) -> str:
        return f"signal {-self.code}" if self.code < 0 else f"code {self.code}"


class Process:
    """A running command.

    Args:
        arguments: of the command.
        cwd: folder that it runs in.
        env: added to this process's environment.
        log: file that its output is added to.
        records: file that its end is added to.
        grace_seconds: between SIGTERM and SIGKILL.

    Raises:
        TrainingError: there is no such program, or no such folder to run in.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        cwd: Path,
        env: Mapping[str, str],
        log: Path,
        records: Path,
        grace_seconds: float,
    ) -> None:
        self._grace = grace_seconds
        self._records = records
        self._started = time.time()
        self.arguments = list(arguments)
        if not cwd.is_dir():
            raise TrainingError(f"detector.cwd: {cwd}: no such folder")
        guarded = [sys.executable, "-S", guard.__file__, str(records), str(grace_seconds)]
        with log.open("ab") as output:
            head = f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} in {cwd}: {_shown(arguments)}\n"
            output.write(head.encode())
            output.flush()
            self._guard = subprocess.Popen(
                [*guarded, *arguments],
                cwd=cwd,
                env={**os.environ, **env},
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for fl3d, which then ends it
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._guard.poll() is None

    def wait(self, seconds: float) -> None:
        """Wait for its end, for so long at most."""
        try:
            self._guard.wait(seconds)
        except subprocess.TimeoutExpired:
            return

    def end(self) -> None:
        """Ask its whole process group to end, and end it if it does not."""
        if self._guard.stdin is not None:
            self._guard.stdin.close()
        code = self._guard.wait()
        if code < 0:  # somebody has killed the guard, and the command runs on
            end_unguarded(self._records)
            _note_end(self._records, self._started, code)


def wait_for_earlier(records: Path, seconds: float) -> None:
    """Wait until no guard of an earlier start runs any more.

    Raises:
        TrainingError: one still does.
    """
    with records.open("a", encoding="utf-8") as file:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                end_unguarded(records)
                return
            except BlockingIOError:
                time.sleep(POLL_SECONDS)
            except OSError:
                return  # a file system without locks
    raise TrainingError(f"{records.parent}: an earlier start of its command has not ended yet")


def end_unguarded(records: Path) -> None:
    """End a command whose guard was killed; it would write where the next start writes."""
    running = records.with_name(f"{records.name}.running")
    try:
        written = json.loads(running.read_text())
        group, started = int(written["group"]), str(written["began"])
    except (OSError, ValueError, KeyError, TypeError):
        return
    # A group whose first process has gone keeps its number as long as it has others.
    if guard.began(group) in ("", started):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(group, signal.SIGKILL)
    running.unlink(missing_ok=True)


def _note_end(records: Path, started: float, code: int) -> None:
    """Add the line that a killed guard could not."""
    found = Exit(started=started, ended=time.time(), code=code, by_fl3d=True)
    with records.open("a") as file:
        file.write(json.dumps(asdict(found)) + "\n")


def read_exits(records: Path) -> list[Exit]:
    """What the starts of a command came to, first to last."""
    if not records.exists():
        return []
    exits = []
    for line in records.read_text(encoding="utf-8", errors="replace").splitlines():
        with contextlib.suppress(ValueError, TypeError):  # of a guard that was killed as it wrote
            exits.append(Exit(**json.loads(line)))
    return exits


def tail(log: Path) -> str:
    """The last lines of a command's output."""
    if not log.exists():
        return ""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - TAIL_BYTES))
        text = file.read().decode(errors="replace")
    return "\n".join(text.splitlines()[-TAIL:])


def _shown(arguments: Sequence[str]) -> str:
    return json.dumps(list(arguments))
