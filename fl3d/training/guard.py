"""Runs a command so that it ends when its starter does: started as a file of its own, with Python's library alone.

The command has a process group of its own. When it has ended, or this process's input is closed (its starter ends it,
or has died of whatever), or it is asked to end, the whole group gets SIGTERM, and after some seconds SIGKILL. A line of
JSON is then added to a file: when it started and ended, and its exit code (negative: the signal that ended it).
Beside that file lies RECORDS.running while the command runs: its process group, for whoever finds this process killed.

    python guard.py RECORDS GRACE_SECONDS ARGUMENT...
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import signal
import subprocess
import sys
import time
from typing import TextIO

POLL_SECONDS = 0.05
NO_PROGRAM = 127  # as shells say it


def main(records: str, grace: float, command: list[str]) -> int:
    """Run the command to its end, or to its starter's."""
    with open(
        records, "a", encoding="utf-8"
    ) as file:  # also a lock: one command at a time in a stage's folder
        with contextlib.suppress(OSError):  # some file systems have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        asked: list[int] = []
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR2):
            signal.signal(number, lambda got, _: asked.append(got))
        started = time.time()
        try:
            child = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        except OSError as error:
            print(f"{command[0]}: {error.strerror}", flush=True)
            _record(file, started, NO_PROGRAM, False)
            return NO_PROGRAM
        with open(f"{records}.running", "w") as running:
            json.dump({"group": child.pid, "began": began(child.pid)}, running)
        while child.poll() is None and not asked and not _is_alone():
            pass
        was_ended = child.poll() is None
        _end_group(child, grace)
        _record(file, started, child.returncode, was_ended)
        os.unlink(f"{records}.running")
    return 0 if was_ended else child.returncode


def began(pid: int) -> str:
    """When a process began, in the kernel's ticks, as numbers are used again; empty where there is none."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[19]
    except OSError:
        return ""


def _record(file: TextIO, started: float, code: int, was_ended: bool) -> None:
    found = {"started": started, "ended": time.time(), "code": code, "by_fl3d": was_ended}
    file.write(json.dumps(found) + "\n")
    file.flush()


def _is_alone() -> bool:
    """Whether the starter has closed this process's input; waits a moment for it."""
    with contextlib.suppress(InterruptedError):
        readable, _, _ = select.select([sys.stdin], [], [], POLL_SECONDS)
        return bool(readable) and not os.read(sys.stdin.fileno(), 1)
    return False


def _end_group(child: subprocess.Popen[bytes], grace: float) -> None:
    """End whatever is left of the command's process group, and wait for the command itself."""
    deadline = time.monotonic() + grace
    _signal(child.pid, signal.SIGTERM)
    while time.monotonic() < deadline and (child.poll() is None or _is_there(child.pid)):
        time.sleep(POLL_SECONDS)
    _signal(child.pid, signal.SIGKILL)
    child.wait()


def _signal(group: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def _is_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except (ProcessLookupError, PermissionError):
        return False
    return True


if __name__ == "__main__":
    code = main(sys.argv[1], float(sys.argv[2]), sys.argv[3:])
    sys.exit(code if code >= 0 else 128 - code)
