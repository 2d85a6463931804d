"""Claims on a folder or a store that end with their holder, however it ends and on whatever machine it ran.

A lease is a small file that its holder renews. On the holder's own machine others see at once that its process has
gone. From other machines the lease ends when somebody has watched it for ``LEASE_SECONDS`` without seeing it renewed:
times of two machines are never compared, for their clocks may disagree, and on Lustre, CephFS and sshfs it is the
client's clock that stamps a file. A holder that was suspended for longer finds out by ``Lease.check`` before it writes.
Taking needs no locks: a lease appears by a hard link, which one taker alone can make.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from fl3d.core.errors import StoreError

LEASE_SECONDS = 60.0  # watched without renewal, after which others take it
RENEW_SECONDS = 10.0
POLL_SECONDS = 0.5
# How file systems say that they have no hard links.
NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL)


@dataclass(frozen=True)
class Holder:
    """Who holds a lease.

    Args:
        token: of this one holding.
        host: machine.
        system: boot and process namespace, within which a process number means something.
        pid: process.
        started: when the process began, in the kernel's ticks, as numbers are used again.
    """

    token: str
    host: str
    system: str
    pid: int
    started: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class Lease:
    """A lease that this process holds.

    Args:
        path: its file.
        holder: this process.
    """

    def __init__(self, path: Path, holder: Holder) -> None:
        self.path, self.holder = path, holder
        self._ended = threading.Event()
        self._renewer = threading.Thread(target=self._renew, daemon=True, name=f"lease {path.name}")
        self._renewer.start()

    def check(self) -> None:
        """Make sure that nobody has taken it over.

        Raises:
            StoreError: somebody has, for this process stood still for too long.
        """
        try:
            holder = _read(self.path)
        except OSError:
            return  # the file system does not answer: nobody else can take it now either
        if holder is None or holder.token != self.holder.token:
            raise StoreError(
                f"{self.path}: taken over by {holder or 'nobody'}, as it was not renewed in time"
            )

    def release(self) -> None:
        """Give it back."""
        self._ended.set()
        with contextlib.suppress(OSError):
            holder = _read(self.path)
            if holder is not None and holder.token == self.holder.token:
                self.path.unlink(missing_ok=True)

    def _renew(self) -> None:
        while not self._ended.wait(RENEW_SECONDS):
            with contextlib.suppress(StoreError, OSError):
                self.check()
                os.utime(self.path)


@contextlib.contextmanager
def leased(path: Path, wait: bool = True) -> Iterator[Lease]:
    """Hold a lease.

    Args:
        path: of its file; folders are made.
        wait: whether to wait for another holder, or to raise as soon as it is known to live.

    Raises:
        StoreError: another process holds it; the message names it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    own, first = _myself(), None
    while (other := _take(path, own)) is not None:
        seen = (other.token, _renewed(path))
        first = first or seen
        # Whether a process of another machine or container lives shows when it renews its lease.
        if not wait and (other.system == own.system or seen != first):
            raise StoreError(f"{path}: in use by {other}; wait for it or end it")
        time.sleep(POLL_SECONDS)
    lease = Lease(path, own)
    try:
        yield lease
    finally:
        lease.release()


def holder_of(path: Path) -> Holder | None:
    """Who holds a lease now; None where nobody does, or whoever did has gone.

    Whether a process of another machine lives can take ``LEASE_SECONDS`` of looks to tell; until then it does.
    """
    holder = _read(path)
    return None if holder is None or _has_gone(path, holder) else holder


def living(paths: Iterable[Path], say: Callable[[str], None] = print) -> dict[Path, Holder]:
    """Leases that are held by processes that surely live; those of other machines may have to be watched for a minute.

    Args:
        paths: of leases.
        say: prints a line for the user, who may have to wait.
    """
    every = list(paths)
    system = _myself().system
    first: dict[Path, tuple[str, float]] = {}
    while True:
        held = {path: holder for path in every if (holder := holder_of(path)) is not None}
        now = {path: (holder.token, _renewed(path)) for path, holder in held.items()}
        if not first and any(holder.system != system for holder in held.values()):
            say("Another machine has been at work here; seeing for a minute whether it still is.")
        first = {**now, **first}
        unsure = [
            path
            for path, holder in held.items()
            if holder.system != system and now[path] == first[path]
        ]
        if not unsure:
            return held
        time.sleep(POLL_SECONDS)


def _take(path: Path, own: Holder) -> Holder | None:
    """Take a lease that is free; else say who has it."""
    with _guard(path):
        while True:
            other = holder_of(path)
            if other is not None:
                return other
            _bury(path, own)
            if _claim(path, own):
                return None


def _claim(path: Path, own: Holder) -> bool:
    """Let the lease appear, whole, unless another's is there."""
    temporary = path.with_name(f".{path.name}.{own.token}.tmp")
    try:
        temporary.write_text(json.dumps(asdict(own)) + "\n")
        os.link(temporary, path)
    except (
        FileExistsError
    ):  # of another taker; or ours, made by a call whose answer a network has lost
        holder = _read(path)
        return holder is not None and holder.token == own.token
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        temporary.replace(path)  # one taker alone by the guard, where that is a lock
    finally:
        temporary.unlink(missing_ok=True)
    return True


def _bury(path: Path, own: Holder) -> None:
    """Put away what a holder that has gone, or a torn write, has left; and back what another has taken meanwhile."""
    before = _read(path)
    grave = path.with_name(f".{path.name}.{own.token}.old.tmp")
    try:
        path.rename(grave)
    except FileNotFoundError:
        return
    try:
        if _read(grave) != before:
            with contextlib.suppress(OSError):
                os.link(grave, path)
    finally:
        grave.unlink(missing_ok=True)


@contextlib.contextmanager
def _guard(path: Path) -> Iterator[None]:
    """One taker at a time, on file systems that have locks: less to do for links, and all there is without them."""
    with path.with_name(f".{path.name}.guard").open("a", encoding="utf-8") as file:
        with contextlib.suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


_watched: dict[Path, tuple[str, float, float]] = {}  # token, stamp, and since when by this machine


def _has_gone(path: Path, holder: Holder) -> bool:
    myself = _myself()
    if (holder.host, holder.system) == (myself.host, myself.system):
        return _start_of(holder.pid) != holder.started
    now = time.monotonic()
    token, stamp, since = _watched.get(path, ("", 0.0, now))
    renewed = _renewed(path)
    if (token, stamp) != (holder.token, renewed):
        _watched[path] = (holder.token, renewed, now)
        return False
    return now - since > LEASE_SECONDS


def _renewed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _read(path: Path) -> Holder | None:
    try:
        return Holder(**json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError, TypeError):
        return None


def _myself() -> Holder:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        system = f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        system = f"unknown {uuid.uuid4().hex}"  # no way to tell whether a process lives: leases end by their age
    pid = os.getpid()
    return Holder(uuid.uuid4().hex, socket.gethostname(), system, pid, _start_of(pid))


def _start_of(pid: int) -> str:
    """When a process began; empty where there is none, or a zombie."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]
