"""Leases: one holder at a time, ended by death at once and by silence in time."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from fl3d.core import leases
from fl3d.core.errors import StoreError
from fl3d.core.leases import Holder, holder_of, leased, living

HOLD = """
import sys, time
from pathlib import Path
from fl3d.core.leases import leased
with leased(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def other_machine(path: Path, age: float) -> Holder:
    """A lease of a process on another machine, last renewed some seconds ago."""
    holder = Holder("token", "elsewhere", "another boot", 1, "1")
    path.write_text(json.dumps(asdict(holder)))
    then = time.time() - age
    os.utime(path, (then, then))
    return holder


class Clock:
    """Time that passes by sleeping alone."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.each: Callable[[], object] = lambda: None
        monkeypatch.setattr(leases.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(leases.time, "sleep", self.sleep)

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.each()


def test_a_lease_is_held_by_one_and_given_back(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "lease"
    with leased(path):
        with (
            pytest.raises(StoreError, match=f"in use by process {os.getpid()} on"),
            leased(path, wait=False),
        ):
            pass
        assert holder_of(path) is not None
    assert holder_of(path) is None
    with leased(path, wait=False):
        pass


def test_the_lease_of_a_killed_process_ends_at_once(tmp_path: Path) -> None:
    path = tmp_path / "lease"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    holder = holder_of(path)
    assert holder is not None
    assert holder.pid == process.pid
    process.kill()
    process.wait()
    process.stdout.close()
    assert holder_of(path) is None
    with leased(path, wait=False):
        pass


def test_a_process_number_that_is_used_again_holds_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lease"
    with leased(path) as lease:
        stranger = replace(lease.holder, token="x", started="12")
    path.write_text(json.dumps(asdict(stranger)))
    assert holder_of(path) is None


@pytest.mark.parametrize("age", [-3600.0, 0.0, 3600.0])
def test_another_machines_lease_ends_when_it_is_seen_not_to_be_renewed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, age: float
) -> None:
    """Whatever time its file has: the clock of whoever stamped it may be an hour off."""
    clock = Clock(monkeypatch)
    path = tmp_path / "lease"
    holder = other_machine(path, age)
    assert holder_of(path) == holder
    clock.now += leases.LEASE_SECONDS - 1
    assert holder_of(path) == holder
    clock.now += 2
    assert holder_of(path) is None


def test_another_machines_lease_that_is_renewed_is_held_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where its clock runs an hour behind ours, and even backwards."""
    clock = Clock(monkeypatch)
    path = tmp_path / "lease"
    holder = other_machine(path, age=3600)
    for age in (3590, 3580, 3570, 3600, 7200):
        assert holder_of(path) == holder
        clock.now += leases.LEASE_SECONDS - 1
        other_machine(path, age)
    assert holder_of(path) == holder


def test_who_asks_once_is_told_after_a_minute_whether_another_machine_lives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(monkeypatch)
    dead, alive, own = tmp_path / "dead", tmp_path / "alive", tmp_path / "own"
    other_machine(dead, age=0)
    other_machine(alive, age=0)
    clock.each = lambda: other_machine(alive, age=clock.now) if clock.now > 10 else None
    said: list[str] = []
    with leased(own) as lease:
        held = living([dead, alive, own, tmp_path / "none"], said.append)
        assert set(held) == {alive, own}
        assert held[own] == lease.holder
    assert leases.LEASE_SECONDS < clock.now < leases.LEASE_SECONDS + 2
    assert len(said) == 1


def test_without_locks_one_of_two_takers_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both see a lease that is free, and neither a lock: the link decides."""
    path = tmp_path / "lease"
    one, other = (replace(leases._myself(), token=name) for name in ("one", "other"))
    monkeypatch.setattr(leases, "_bury", lambda path, own: leases._claim(path, other))
    holder = leases._take(path, one)
    assert holder == other
    assert json.loads(path.read_text())["token"] == "other"
    assert list(tmp_path.glob("*.tmp")) == list(tmp_path.glob(".*.tmp")) == []


def test_a_living_lease_that_was_put_away_by_mistake_comes_back(tmp_path: Path) -> None:
    """Somebody took it between our look, which saw it dead, and our renaming."""
    path = tmp_path / "lease"
    path.write_text("torn")
    with leased(path) as lease:
        read = leases._read
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(leases, "_read", _first_none(read))
            leases._bury(path, replace(lease.holder, token="late"))
        lease.check()
    assert not path.exists()
    assert list(tmp_path.glob(".*.tmp")) == []


def _first_none(read: Callable[[Path], Holder | None]) -> Callable[[Path], Holder | None]:
    looks: list[Path] = []

    def look(path: Path) -> Holder | None:
        looks.append(path)
        return None if len(looks) == 1 else read(path)

    return look


def test_a_lease_is_renewed_while_it_is_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "RENEW_SECONDS", 0.02)
    path = tmp_path / "lease"
    with leased(path):
        os.utime(path, (0, 0))
        deadline = time.monotonic() + 20
        while path.stat().st_mtime == 0:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_holder_that_slept_too_long_finds_out_and_leaves_the_new_one_alone(
    tmp_path: Path,
) -> None:
    path = tmp_path / "lease"
    with leased(path) as lease:
        newer = other_machine(path, age=0)
        with pytest.raises(StoreError, match="taken over by process 1 on elsewhere"):
            lease.check()
    assert holder_of(path) == newer


def test_many_who_ask_at_once_hold_it_one_after_another(tmp_path: Path) -> None:
    """Eight processes count up a number that only the holder may touch."""
    counter = tmp_path / "counter"
    counter.write_text("0")
    code = (
        "import sys, fl3d.core.leases as leases; from pathlib import Path; leases.POLL_SECONDS = 0.01\n"
        "counter = Path(sys.argv[1])\n"
        "for _ in range(5):\n"
        "    with leases.leased(counter.with_name('lease')):\n"
        "        counter.write_text(str(int(counter.read_text()) + 1))\n"
    )
    processes = [subprocess.Popen([sys.executable, "-c", code, str(counter)]) for _ in range(8)]
    assert [process.wait(timeout=120) for process in processes] == [0] * 8
    assert counter.read_text() == "40"
