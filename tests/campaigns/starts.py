"""Start fl3d as often as a campaign needs it, and find and end the processes that it has started.

A start is a fork of this process, which has loaded fl3d once: a tenth of the time of ``python -m fl3d``, and the same
code from ``fl3d.cli.main`` on. This process adopts whatever its starts leave behind, so that no orphan is overlooked.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import multiprocessing.util
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36  # <linux/prctl.h>
LOADED = ("fl3d.commands.train", "fl3d.commands.import", "mlflow", "optuna", "matplotlib.pyplot")


def load() -> None:
    """Load what every start needs, and adopt the orphans of all starts."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for name in LOADED:
        importlib.import_module(name)


class Start:
    """fl3d with some words, in a process of its own.

    Args:
        words: behind ``python -m fl3d``.
        log: file that its output is added to.
        before: called in the new process first.
    """

    def __init__(
        self, words: Sequence[str], log: Path, before: Callable[[], None] | None = None
    ) -> None:
        self.words = list(words)
        self.began = time.time()
        self.code: int | None = None
        self._skip = log.stat().st_size if log.exists() else 0
        self._log = log
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _become(self.words, log, before)

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        if self.code is None:
            with contextlib.suppress(ChildProcessError):
                pid, status = os.waitpid(self.pid, os.WNOHANG)
                if pid:
                    self.code = os.waitstatus_to_exitcode(status)
        return self.code is None

    def wait(self, seconds: float) -> bool:
        """Wait for its end; whether it came within some seconds."""
        deadline = time.monotonic() + seconds
        while self.is_running and time.monotonic() < deadline:
            time.sleep(0.02)
        return not self.is_running

    def said(self) -> str:
        """All that it has printed."""
        with self._log.open("rb") as file:
            file.seek(self._skip)
            return file.read().decode(errors="replace")


def _become(words: list[str], log: Path, before: Callable[[], None] | None) -> None:
    code = 1
    try:
        os.setsid()
        output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for number, file in ((0, nothing), (1, output), (2, output)):
            os.dup2(file, number)
        if before is not None:
            before()
        code = called(words)
    finally:
        with contextlib.suppress(BaseException):
            multiprocessing.util._exit_function()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def called(words: Sequence[str]) -> int:
    """Call the command line in this process; its exit code. A traceback is printed, as Python does."""
    from fl3d.cli import main

    try:
        main(list(words))
    except SystemExit as error:
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
            return 1
        return int(error.code or 0)
    except BaseException:
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        return 1
    return 0


def descendants(pid: int | None = None) -> dict[int, str]:
    """Processes that a process, by default this one, has started, directly or not: their command lines."""
    children: dict[int, list[int]] = {}
    lines: dict[int, str] = {}
    for entry in os.listdir("/proc"):
        if not entry.isdigit():
            continue
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{entry}/stat").read_text().rpartition(")")[2].split()
            if fields[0] in "ZX":
                continue
            children.setdefault(int(fields[1]), []).append(int(entry))
            text = Path(f"/proc/{entry}/cmdline").read_bytes()
            lines[int(entry)] = text.replace(b"\0", b" ").decode(errors="replace").strip()
    found: dict[int, str] = {}
    todo = [pid or os.getpid()]
    while todo:
        for child in children.get(todo.pop(), []):
            if child not in found:
                found[child] = lines.get(child, "")
                todo.append(child)
    return found


def kill(pids: Iterable[int], number: int = signal.SIGKILL) -> None:
    """Send a signal to processes that may have gone."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def reap(but: Iterable[int] = ()) -> None:
    """Forget adopted processes that have ended."""
    keep = set(but)
    for entry in os.listdir("/proc"):
        if entry.isdigit() and int(entry) not in keep:
            with contextlib.suppress(OSError, ChildProcessError):
                os.waitpid(int(entry), os.WNOHANG)


def orphans(but: Iterable[int] = (), seconds: float = 30.0) -> dict[int, str]:
    """Processes that are still there after some seconds, though what started them has gone."""
    keep = set(but)
    for pid in but:
        keep |= set(descendants(pid))
    deadline = time.monotonic() + seconds
    while True:
        reap(keep)
        left = {pid: line for pid, line in descendants().items() if pid not in keep}
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.1)
