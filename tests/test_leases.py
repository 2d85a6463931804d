"""Leases: one holder at a time, ended by death at once and by silence in time."""

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from fl3d.core import leases
from fl3d.core.errors import StoreError
from fl3d.core.leases import Holder, holder_of, leased

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


def test_another_machines_lease_ends_when_it_is_not_renewed(tmp_path: Path) -> None:
    path = tmp_path / "lease"
    holder = other_machine(path, age=leases.LEASE_SECONDS - 20)
    assert holder_of(path) == holder
    other_machine(path, age=leases.LEASE_SECONDS + 20)
    assert holder_of(path) is None


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
