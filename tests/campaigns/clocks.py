"""Two machines whose clocks disagree take turns at one lease, and die while they hold it.

    python -m tests.campaigns.clocks --seed 0

A process plays a machine: it has a host name and a boot of its own, and stamps files by a clock that is ahead or
behind, as clients of Lustre, CephFS and sshfs do; locks are not kept. Time runs twenty times as fast: a minute's
lease is three seconds. At no time may two of them hold the lease, and that of a dead one must pass on in bounded time.
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from tests.campaigns.runner import Asked, Found, main

FASTER = 20.0
LEASE, RENEW, POLL = 60.0 / FASTER, 10.0 / FASTER, 0.5 / FASTER
MINUTE, HOUR = 60.0 / FASTER, 3600.0 / FASTER
SKEWS = (MINUTE, -MINUTE, HOUR, -HOUR, 0.0)
TURNS = 3  # that each machine has
BOUND = (
    2.0  # leases' lengths within which that of a dead machine must pass on; measured: 1.0 to 1.2
)


@dataclass(frozen=True)
class Held:
    """A stretch of time for which a machine held the lease, by the one clock that all processes share."""

    machine: str
    first: float
    last: float


def machine(
    name: str, skew: float, path: Path, notes: Path, turns: int, rng: random.Random
) -> None:
    """Take the lease several times, for longer than it lasts unrenewed; note when it was surely held."""
    _become(name, skew)
    from fl3d.core.errors import StoreError
    from fl3d.core.leases import leased

    with notes.open("a") as file:
        for _ in range(turns):
            with leased(path) as lease:
                first = last = time.monotonic()
                print(f"{name} took {first}", file=file, flush=True)
                end = first + rng.uniform(0.5, 2.5) * LEASE
                try:
                    while time.monotonic() < end:
                        lease.check()
                        last = time.monotonic()
                        print(f"{name} held {first} {last}", file=file, flush=True)
                        time.sleep(POLL)
                except StoreError:
                    print(f"{name} lost {last}", file=file, flush=True)
            time.sleep(rng.uniform(0, 0.2) * LEASE)


def _become(name: str, skew: float) -> None:
    """Be another machine, with a clock of its own that stamps its files."""
    from fl3d.core import leases

    leases.LEASE_SECONDS, leases.RENEW_SECONDS, leases.POLL_SECONDS = LEASE, RENEW, POLL
    leases.fcntl.flock = lambda *_: None  # type: ignore[assignment]
    own = leases._myself
    leases._myself = lambda: replace(own(), host=name, system=f"boot of {name}")  # type: ignore[assignment]
    utime = os.utime

    def stamp(path: Path, times: object = None, **named: object) -> None:
        now = time.time() + skew
        utime(path, (now, now))

    os.utime = stamp  # type: ignore[assignment]
    link = os.link

    def linked(source: Path, target: Path, **named: object) -> None:
        stamp(source)
        link(source, target)

    os.link = linked  # type: ignore[assignment]


def _start(*arguments: object) -> int:
    pid = os.fork()
    if pid == 0:
        try:
            machine(*arguments)  # type: ignore[arg-type]
        finally:
            os._exit(0)
    return pid


def held(notes: Path) -> Iterator[Held]:
    """Stretches that machines noted."""
    found: dict[tuple[str, str], Held] = {}
    for line in notes.read_text().splitlines():
        name, what, first, *rest = line.split()
        if what == "held":
            found[name, first] = Held(name, float(first), float(rest[0]))
    yield from found.values()


def overlaps(stretches: list[Held]) -> list[tuple[Held, Held]]:
    """Pairs of stretches of two machines that share time."""
    return [
        (one, other)
        for number, one in enumerate(stretches)
        for other in stretches[number + 1 :]
        if one.machine != other.machine and one.first < other.last and other.first < one.last
    ]


def turns(work: Path, skew: float, rng: random.Random, found: Found) -> None:
    """Both live, and take turns."""
    path, notes = work / "lease", work / "notes.txt"
    pids = [
        _start("a", 0.0, path, notes, TURNS, random.Random(rng.random())),
        _start("b", skew, path, notes, TURNS, random.Random(rng.random())),
    ]
    for pid in pids:
        os.waitpid(pid, 0)
    stretches = list(held(notes))
    lost = notes.read_text().count(" lost ")
    both = overlaps(stretches)
    text = f"clocks {skew * FASTER:+.0f} s apart"
    found.check(len(stretches) == 2 * TURNS, f"{text}: {len(stretches)} turns of {2 * TURNS}")
    found.check(not both, f"{text}: held by both: {both[:2]}")
    found.check(not lost, f"{text}: {lost} times taken from a living holder")


def death(work: Path, skew: float, rng: random.Random, found: Found) -> float:
    """One dies while it holds the lease; after how many leases' lengths the other has it."""
    path, notes = work / "lease", work / "notes.txt"
    dying = _start("a", 0.0, path, notes, 1000, random.Random(0))
    while not (notes.exists() and "a held" in notes.read_text()):
        time.sleep(0.01)
    other = _start("b", skew, path, notes, 1, rng)
    time.sleep(rng.uniform(0.1, 1.0) * RENEW)
    os.kill(dying, signal.SIGKILL)
    os.waitpid(dying, 0)
    died = time.monotonic()
    deadline = died + 10 * LEASE
    while "b took" not in notes.read_text() and time.monotonic() < deadline:
        time.sleep(0.01)
    taken = [line for line in notes.read_text().splitlines() if line.startswith("b took")]
    if not taken:
        os.kill(other, signal.SIGKILL)
    os.waitpid(other, 0)
    waited = (float(taken[0].split()[2]) - died) / LEASE if taken else float("inf")
    text = f"clocks {skew * FASTER:+.0f} s apart"
    found.check(waited < BOUND, f"{text}: taken over {waited:.1f} leases after the death")
    return waited


def campaign(asked: Asked) -> Found:
    """Turns and deaths under each disagreement, several times."""
    found = Found()
    rng = random.Random(asked.seed)
    waits = []
    for number in range(asked.count):
        skew = SKEWS[number % len(SKEWS)]
        for kind in ("turns", "death"):
            work = asked.work / f"{kind}{number}"
            work.mkdir()
            if kind == "turns":
                turns(work, skew, rng, found)
            else:
                waits.append(death(work, skew, rng, found))
    found.figures.append(
        f"{asked.count} times two machines in turns, {asked.count} deaths; a lease passed on within "
        f"{min(waits):.1f} to {max(waits):.1f} of its lengths"
    )
    return found


if __name__ == "__main__":
    main(campaign, __doc__, 20)
