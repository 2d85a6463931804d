"""Ctrl-C, SIGTERM and SIGHUP end a command alike: once, with a line, and with an exit code of their own."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import fl3d.commands.clean
from fl3d.cli import main
from fl3d.core import interrupts
from fl3d.core.interrupts import Interrupted, end_with_parent

ROOT = Path(__file__).resolve().parent.parent
HEARD = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture(autouse=True)
def not_ignored() -> Iterator[None]:
    """Tests that are started by nohup, or in the background of a script, inherit signals that are ignored."""
    before = {number: signal.getsignal(number) for number in HEARD}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


# Says when it is ready, waits, and takes a while to end.
WAITING = """
import sys, time
from fl3d.core import interrupts
interrupts.listen()
{before}
with interrupts.heard():
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt as error:
        print("ending", flush=True)
        end = time.monotonic() + {ending}
        while time.monotonic() < end:
            time.sleep(0.01)
        print("ended", flush=True)
        sys.exit(interrupts.code(error.number))
"""


def waiting(before: str, ending: float = 0.0, ignored: int = 0) -> "subprocess.Popen[str]":
    def as_inherited() -> None:
        for number in HEARD:
            signal.signal(number, signal.SIG_IGN if number == ignored else signal.SIG_DFL)

    process = subprocess.Popen(
        [sys.executable, "-c", WAITING.format(before=before, ending=ending)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=as_inherited,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize("number", HEARD)
def test_while_modules_are_loaded_a_signal_ends_with_one_line(number: signal.Signals) -> None:
    process = waiting("")
    process.send_signal(number)
    out, error = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert out == ""
    assert error == interrupts.text(number, "nothing was begun") + "\n"


@pytest.mark.parametrize("number", HEARD)
def test_later_it_passes_through_what_has_to_be_ended(number: signal.Signals) -> None:
    process = waiting("interrupts.loaded()")
    process.send_signal(number)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert out == "ending\nended\n"


def test_a_second_signal_does_not_disturb_the_ending() -> None:
    process = waiting("interrupts.loaded()", ending=1.0)
    assert process.stdout is not None
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "ending\n"
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "ended\n"
    assert error == "fl3d: is ending already; once more leaves at once\n"


def test_a_third_leaves_at_once() -> None:
    process = waiting("interrupts.loaded()", ending=600)
    assert process.stdout is not None
    assert process.stderr is not None
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "ending\n"
    process.send_signal(signal.SIGINT)
    assert "once more" in process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    out, error = process.communicate(timeout=60)
    assert process.returncode == 143
    assert out == ""
    assert error == "fl3d: ended by SIGTERM; left at once\n"


@pytest.mark.parametrize("ignored", [signal.SIGHUP, signal.SIGINT])
def test_what_the_starter_ignores_stays_ignored_and_sigterm_ends_it(
    ignored: signal.Signals,
) -> None:
    """As under nohup, and behind & in a script."""
    process = waiting("interrupts.loaded()", ignored=ignored)
    process.send_signal(ignored)
    time.sleep(0.2)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 143
    assert out == "ending\nended\n"


def test_sigterm_ends_it_even_where_the_starter_ignores_that() -> None:
    process = waiting("interrupts.loaded()", ignored=signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 143


def test_a_forked_child_dies_of_a_signal_as_any_process() -> None:
    with interrupts.heard():
        child = os.fork()
        if child == 0:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
            os._exit(0)
        _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGTERM


def test_signals_mean_afterwards_what_they_meant_before() -> None:
    before = [signal.getsignal(number) for number in HEARD]
    with interrupts.heard():
        assert [signal.getsignal(number) for number in HEARD] != before
    assert [signal.getsignal(number) for number in HEARD] == before


def test_commands_run_in_any_thread() -> None:
    """Python hears signals in its main thread alone; elsewhere they are left as they are."""
    ended: list[bool] = []

    def run() -> None:
        with interrupts.heard(), interrupts.deaf_children():
            ended.append(True)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert ended == [True]


def test_a_signal_that_a_library_swallows_is_raised_by_the_next_look() -> None:
    with interrupts.heard():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)
        except BaseException:
            pass
        with pytest.raises(Interrupted) as raised:
            interrupts.check()
    assert raised.value.number == signal.SIGTERM
    with interrupts.heard():
        interrupts.check()  # the next command has heard nothing


@pytest.mark.parametrize("number", HEARD)
def test_a_command_that_is_interrupted_says_how_to_go_on(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(arguments: list[str]) -> None:
        os.kill(os.getpid(), number)
        time.sleep(10)

    monkeypatch.setattr(fl3d.commands.clean, "run", command)
    with pytest.raises(SystemExit) as end:
        main(["clean"])
    assert end.value.code == 128 + number
    interrupts.check()  # what is run in this process afterwards is not interrupted
    said = {signal.SIGINT: "interrupted"}.get(number, f"ended by {number.name}")
    assert capsys.readouterr().err == f"fl3d: {said}; run the same command again\n"


ENDED = """
import atexit, sys, time
from fl3d.core import interrupts
def late():
    print("late", flush=True)
    time.sleep(60)
atexit.register({late})
interrupts.listen()
atexit.register({early})
interrupts.loaded()
with interrupts.heard():
    pass
sys.exit(7)
"""


@pytest.mark.parametrize(
    ("early", "late", "code"), [("late", "int", 128 + 15), ("int", "late", None)]
)
def test_a_signal_after_the_end_neither_raises_nor_changes_the_exit_code(
    early: str, late: str, code: int | None
) -> None:
    """While Python calls what has to be called at its exit the process leaves at once; later it is deaf."""
    process = subprocess.Popen(
        [sys.executable, "-c", ENDED.format(early=early, late=late)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "late\n"
    process.send_signal(signal.SIGTERM)
    if code is None:
        time.sleep(0.2)
        assert process.poll() is None
        process.kill()
    _, error = process.communicate(timeout=60)
    assert process.returncode == (code or -signal.SIGKILL)
    assert error == ("fl3d: ended by SIGTERM\n" if code else "")


WORKING = """
import multiprocessing as mp, os, sys, time
from fl3d.core.interrupts import end_with_parent
def work(path):
    end_with_parent()
    with open(path, "w") as file:
        file.write(str(os.getpid()))
    time.sleep(600)
if __name__ == "__main__":
    mp.get_context("forkserver").Process(target=work, args=(sys.argv[1],)).start()
    time.sleep(600)
"""


def test_a_worker_ends_with_its_parent_even_if_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "working.py").write_text(WORKING)
    pid = tmp_path / "pid"
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "working.py"), str(pid)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    deadline = time.monotonic() + 60
    while not (pid.exists() and pid.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    parent.kill()
    parent.wait()
    while Path(f"/proc/{pid.read_text()}").exists():
        assert time.monotonic() < deadline, "the worker outlives its parent"
        time.sleep(0.05)


def test_a_process_without_a_parent_of_its_own_kind_is_left_alone() -> None:
    before = threading.active_count()
    end_with_parent()
    assert threading.active_count() == before
