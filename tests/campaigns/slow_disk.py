"""A sweep on a file system that answers slowly, loses its locks, lists late and fails now and then.

    python -m tests.campaigns.slow_disk --seed 0

Calls on files of the store are delayed at random; locks succeed without locking, or fail; a folder's listing may
lack what was written just now; one call in 300 ends in ESTALE, EIO or EAGAIN. Two sweeps that share their
stages run on it at once, and are started again until they end. Each start must end with 0 or a clear error, and nothing
may be lost or doubled.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import io
import os
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.campaigns import checks
from tests.campaigns.parts import SMALL, share
from tests.campaigns.runner import Asked, Found, main
from tests.campaigns.starts import Start, kill, load, orphans

SLOW, SECONDS = 0.1, 0.02  # share of calls that are delayed, and by how much at most
FAILS = 1 / 300  # share of calls that fail
LATE, AGE = 0.2, 0.5  # share of listings that lack what is younger than so many seconds
STARTS = 25  # of each sweep at most
PATIENCE = 900.0
ERRORS = (errno.ESTALE, errno.EIO, errno.EAGAIN)


class Disk:
    """The faults of one process.

    Args:
        root: files below it are affected.
        seed: of the random numbers.
        locks: what becomes of locks: ``lost`` or ``refused``.
        counts: file that the faults are counted in.
    """

    def __init__(self, root: Path, seed: str, locks: str, counts: Path) -> None:
        self.root, self.locks, self.counts = str(root), locks, counts
        self.rng = random.Random(seed)

    def break_it(self) -> None:
        """Put the faults in the places of the calls."""
        for name in ("stat", "rename", "replace", "utime", "unlink", "mkdir", "listdir", "link"):
            setattr(os, name, self._faulty(getattr(os, name), name))
        opened = self._faulty(io.open, "open")
        io.open = builtins.open = opened  # type: ignore[assignment]
        scandir = self._faulty(os.scandir, "scandir")
        os.scandir = lambda path=".": _Late(scandir(path), self)  # type: ignore[assignment]
        fcntl.flock = fcntl.lockf = self._lock  # type: ignore[assignment]

    def _lock(self, *_: object) -> None:
        if self.locks == "refused":
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    def _faulty(self, call: Callable[..., Any], name: str) -> Callable[..., Any]:
        def faulty(path: Any = ".", *arguments: Any, **named: Any) -> Any:
            if isinstance(path, str | os.PathLike) and str(path).startswith(self.root):
                if self.rng.random() < SLOW:
                    time.sleep(self.rng.uniform(0, SECONDS))
                if self.rng.random() < FAILS:
                    number = self.rng.choice(ERRORS)
                    fd = os.open(self.counts, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
                    os.write(fd, f"{name} {errno.errorcode[number]}\n".encode())
                    os.close(fd)
                    raise OSError(number, os.strerror(number), str(path))
            return call(path, *arguments, **named)

        return faulty

    def is_late(self, entry: os.DirEntry[str]) -> bool:
        """Whether a listing lacks an entry."""
        if not entry.path.startswith(self.root) or self.rng.random() > LATE:
            return False
        try:
            return time.time() - entry.stat(follow_symlinks=False).st_mtime < AGE
        except OSError:
            return True


class _Late:
    """A listing that may lack what is new."""

    def __init__(self, entries: Any, disk: Disk) -> None:
        self._entries, self._disk = entries, disk

    def __enter__(self) -> _Late:
        return self

    def __exit__(self, *_: object) -> None:
        self._entries.close()

    def __iter__(self) -> Iterator[os.DirEntry[str]]:
        return (entry for entry in self._entries if not self._disk.is_late(entry))

    def __next__(self) -> os.DirEntry[str]:
        for entry in self._entries:
            if not self._disk.is_late(entry):
                return entry
        raise StopIteration

    def close(self) -> None:
        self._entries.close()


def words(shared: Path, work: Path, name: str) -> list[str]:
    """A sweep; both have the same trials."""
    small = [word.format(shared=shared) for word in SMALL]
    places = [f"store.root={work / 'runs'}", f"results={work / 'results' / name}"]
    return [
        "-m",
        "detector=fcn3d",
        "loss.gamma=0,2",
        f"sweep.name={name}",
        *small,
        *places,
        "hydra/launcher=inline",
    ]


def sweep(shared: Path, work: Path, locks: str, seed: str, found: Found) -> Counter[str]:
    """Two sweeps at once, until both have ended."""
    ends: Counter[str] = Counter()
    names = ("one", "two")
    running: dict[str, Start] = {}
    done: set[str] = set()
    starts: Counter[str] = Counter()
    deadline = time.monotonic() + PATIENCE
    while len(done) < len(names):
        for name in names:
            if name in done or (name in running and running[name].is_running):
                continue
            if name in running:
                _judge(running[name], locks, ends, found)
                if running[name].code == 0:
                    done.add(name)
                    continue
            if starts[name] >= STARTS or time.monotonic() > deadline:
                found.check(False, f"{locks}: {name} has not ended after {starts[name]} starts")
                for start in running.values():
                    if start.is_running:
                        kill([start.pid])
                return ends
            starts[name] += 1
            disk = Disk(work / "runs", f"{seed} {name} {starts[name]}", locks, work / "faults.txt")
            running[name] = Start(words(shared, work, name), work / f"{name}.txt", disk.break_it)
        time.sleep(0.1)
    return ends


def _judge(start: Start, locks: str, ends: Counter[str], found: Found) -> None:
    said = start.said()
    found.check("Traceback" not in said, f"{locks}: a traceback, code {start.code}: {said[-900:]}")
    found.check(start.code in (0, 1, 2), f"{locks}: code {start.code}")
    found.check(start.code == 0 or "fl3d: " in said, f"{locks}: no clear error: {said[-500:]}")
    ends["ended" if start.code == 0 else f"error, code {start.code}"] += 1


def campaign(asked: Asked) -> Found:
    """Undisturbed once; then with lost locks and with refused ones, so many times each."""
    load()
    found = Found()
    shared = asked.work / "shared"
    if not shared.exists():
        share(shared)
    whole = asked.work / "whole"
    whole.mkdir()
    start = Start(words(shared, whole, "one"), whole / "log.txt")
    if not start.wait(600) or start.code:
        raise RuntimeError(start.said())
    expected = _tables(whole / "results" / "one", "one")
    for number in range(asked.count):
        for locks in ("lost", "refused"):
            work = asked.work / f"{locks}{number}"
            work.mkdir()
            ends = sweep(shared, work, locks, f"{asked.seed} {number}", found)
            for name in ("one", "two"):
                own = _tables(work / "results" / name, name)
                found.check(own == expected, f"{locks} {number}: tables of {name} differ")
            runs = work / "runs"
            for wrong in [*checks.doubled_or_lost(runs), *checks.still_running(runs)]:
                found.check(False, f"{locks} {number}: {wrong}")
            left = orphans()
            found.check(not left, f"{locks} {number}: orphans {left}")
            faults = work / "faults.txt"
            made = Counter(faults.read_text().splitlines()) if faults.exists() else Counter()
            found.figures.append(
                f"locks {locks}: {dict(ends)}; {made.total()} calls failed: {dict(made)}"
            )
    return found


def _tables(results: Path, name: str) -> dict[str, bytes]:
    own = checks.contents(results / "simulated-tiny" / "tables")
    return {
        key.replace(name, "N"): value.replace(name.encode(), b"N") for key, value in own.items()
    }


if __name__ == "__main__":
    main(campaign, __doc__, 3)
