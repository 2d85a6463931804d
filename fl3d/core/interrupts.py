"""Ctrl-C, SIGTERM and SIGHUP all end a command alike, by an exception that passes through what has to be ended.

While modules are being loaded there is nothing to end: the process leaves at once. Later the first signal raises
``Interrupted``; the second says that ending takes a moment; the third leaves at once. Processes on this machine that
work for a command end by themselves when it has gone, see ``end_with_parent``. What a starter has told to ignore
SIGINT or SIGHUP (``nohup``, ``&`` in a script) goes on ignoring it.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

# The only imports are Python's own and light: this is loaded before anything else.
HEARD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
NAMES = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "ended by SIGTERM",
    signal.SIGHUP: "ended by SIGHUP",
}


Handler = Callable[[int, FrameType | None], object] | int | None


class Interrupted(KeyboardInterrupt):
    """The command was asked to end.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class _Listener:
    """What this process has heard; a process has one set of signals, and so one of these."""

    def __init__(self) -> None:
        self.heard: list[int] = []
        self.at_once: str | None = None  # what to say, where there is nothing to end
        self.may_leave = False  # whether the process is the command's own, and not a notebook's
        self.owner = 0  # process that listens; 0: none does

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self.owner:  # a child that was forked: not its business
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        self.heard.append(number)
        if self.at_once is not None or (self.may_leave and len(self.heard) > 2):
            _write(text(number, "left at once" if self.at_once is None else self.at_once))
            os._exit(code(number))
        if len(self.heard) != 2:
            raise Interrupted(number)
        _write("fl3d: is ending already; once more leaves at once")


_LISTENER = _Listener()


def listen() -> None:
    """Hear signals from now on, in a process that does nothing else than run a command, and is still loading."""
    _LISTENER.at_once = "nothing was begun"
    _LISTENER.may_leave = True
    _install()
    atexit.register(_deafen)  # the first that is registered is called last


def loaded() -> None:
    """From now on there may be something to end."""
    _LISTENER.at_once = None


@contextlib.contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that are started inside do not hear Ctrl-C, which a terminal sends to all: they end with this one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def heard() -> Iterator[None]:
    """Hear signals while a command runs; afterwards they mean what they did before."""
    _LISTENER.heard.clear()
    before = _install()
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _LISTENER.heard.clear()  # a sweep that a notebook runs afterwards has heard nothing
        if _LISTENER.may_leave:
            _LISTENER.at_once = ""


def check() -> None:
    """Raise what was heard, if a library has swallowed it.

    Raises:
        Interrupted: a signal was heard.
    """
    if _LISTENER.heard:
        raise Interrupted(_LISTENER.heard[0])


def code(number: int) -> int:
    """The exit code of what a signal has ended, as shells have it."""
    return 128 + number


def text(number: int, hint: str = "") -> str:
    """What is said at the end."""
    name = NAMES.get(signal.Signals(number), "interrupted")
    return f"fl3d: {name}" + (f"; {hint}" if hint else "")


def end_with_parent() -> None:
    """End this process as soon as the one that asked for it has gone, however that went.

    Only for processes of ``multiprocessing``; their own parent may be a fork server.
    """
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is None or parent.sentinel is None:  # joblib's has none
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="end with parent").start()


def _install() -> dict[int, Handler]:
    """Take the signals that are not ignored; what they meant before, by their numbers."""
    if threading.current_thread() is not threading.main_thread():
        return {}  # Python hears signals in its main thread alone
    before: dict[int, Handler] = {}
    for number in HEARD:
        handler = signal.getsignal(number)
        if handler is _LISTENER or (handler is signal.SIG_IGN and number != signal.SIGTERM):
            continue
        before[number] = signal.signal(number, _LISTENER)
    _LISTENER.owner = os.getpid()
    return before


def _deafen() -> None:
    """The last milliseconds of a process, in which Python itself would die of a second Ctrl-C."""
    for number in HEARD:
        signal.signal(number, signal.SIG_IGN)


def _write(line: str) -> None:
    """Write a line on the error stream from within a signal handler, below what a terminal shows of Ctrl-C or a bar."""
    lead = "\n" if os.isatty(2) else ""
    with contextlib.suppress(OSError):
        os.write(2, f"{lead}{line}\n".encode())
