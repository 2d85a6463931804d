"""The store in a browser: one process, at a port that is free, which leaves nothing behind."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn

from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.interrupts import Interrupted
from fl3d.store.base import Scored
from fl3d.store.mlflow.server import Server
from fl3d.store.mlflow.tracking import MlflowStore
from fl3d.store.mlflow.ui import HOST, NEXT_PORTS, PORT, browse, free_port, take_port

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_SECONDS = 240  # on a machine that is busy; MLflow takes ten to start on one that is not


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody listens at."""
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        yield int(other.getsockname()[1])


def test_a_port_that_was_asked_for_and_is_in_use_is_refused_naming_a_free_one(taken: int) -> None:
    with pytest.raises(ConfigError, match=rf"--port {taken}: in use\. Give another") as caught:
        take_port(taken)
    free = int(re.findall(r"such as --port (\d+)", str(caught.value))[0])
    with take_port(free) as bound:
        assert bound.getsockname() == (HOST, free)


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_what_is_no_port_is_refused(port: int) -> None:
    with pytest.raises(ConfigError, match="a port is a number from 1 to 65535"):
        take_port(port)


def test_of_its_own_it_takes_one_that_is_free() -> None:
    with free_port() as first, free_port() as second:
        one, two = (bound.getsockname()[1] for bound in (first, second))
    assert one in (PORT, *NEXT_PORTS)
    assert two in NEXT_PORTS
    assert one < two


def test_without_a_store_nothing_is_made(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no store yet"):
        browse(tmp_path / "runs", None, None)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_server_and_is_no_error_of_an_answer(number: signal.Signals) -> None:
    """An exception would be taken for one, and the server would go on."""
    before = signal.signal(number, signal.SIG_DFL)  # this test may be run under nohup
    server = Server(uvicorn.Config("none"))
    try:
        with pytest.raises(Interrupted) as caught:
            _hear_twice(server, number)
        assert caught.value.number == number
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)


def _hear_twice(server: Server, number: signal.Signals) -> None:
    with server.capture_signals():
        assert not server.should_exit
        signal.raise_signal(number)
        assert server.should_exit
        assert not server.force_exit
        signal.raise_signal(number)
        assert server.force_exit


def test_under_nohup_it_goes_on() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    server = Server(uvicorn.Config("none"))
    try:
        with server.capture_signals():
            signal.raise_signal(signal.SIGHUP)
        assert not server.should_exit
    finally:
        signal.signal(signal.SIGHUP, before)


def processes_of(session: int) -> set[int]:
    """Ids of the processes of a session that live."""
    found = set()
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                state, _, _, own = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            except OSError:  # it has gone meanwhile
                continue
            if int(own) == session and state != "Z":
                found.add(int(folder.name))
    return found


def started(root: Path) -> "tuple[subprocess.Popen[str], str]":
    """`fl3d ui` over a store, as a session of its own, and its address; it answers."""

    def as_inherited() -> None:
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    process = subprocess.Popen(
        [sys.executable, "-m", "fl3d", "ui", f"store.root={root}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=as_inherited,
        start_new_session=True,
    )
    assert process.stdout is not None
    said = ""
    while "Ctrl-C ends it" not in said:
        line = process.stdout.readline()
        assert line, said
        said += line
    address = re.findall(r"http://[\d.:]+", said)[0]
    assert (f"this is port {address.rpartition(':')[2]}" in said) == (f":{PORT}" not in address)
    end = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < end:
        try:
            with urllib.request.urlopen(f"{address}/health", timeout=10) as answer:
                assert answer.read() == b"OK"
                return process, address
        except OSError:
            time.sleep(0.2)
    raise AssertionError(said)


@pytest.mark.slow  # fl3d and MLflow start four times
def test_it_is_one_process_and_whatever_ends_it_leaves_none_behind(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    store = MlflowStore(root)
    store.open()
    run = store.run(store.experiment("shown", "**a note**"), "trial", "p", "named", {}, {})
    store.log(run, Scored(1, 0, {"ap_3d/moderate": 1.0}))
    with free_port():  # 5000, or what is free of the next: it takes another
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGKILL):
            process, address = started(root)
            try:
                body = b'{"experiment_ids": ["1"]}'
                asked = urllib.request.Request(
                    f"{address}/ajax-api/2.0/mlflow/runs/search",
                    data=body,
                    headers={"Content-Type": "application/json"},
                )
                with urllib.request.urlopen(asked, timeout=60) as answer:
                    assert b"named" in answer.read()
                assert processes_of(process.pid) == {process.pid}
                process.send_signal(number)  # the answer above may not have ended yet
                said, _ = process.communicate(timeout=PATIENCE_SECONDS)
                assert process.returncode == (-9 if number == signal.SIGKILL else 128 + number)
                assert "Traceback" not in said
                assert processes_of(process.pid) == set()
            finally:
                process.kill()
