"""Processes on this machine, one torch thread each."""

from __future__ import annotations

import atexit
import contextlib
import gc
import itertools
import multiprocessing as mp
import os
import pkgutil
import signal
import sys
import time
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path

import torch

import fl3d.detectors
from fl3d.core.errors import StageFailed
from fl3d.core.interrupts import deaf_children, end_with_parent
from fl3d.core.processes import without_main
from fl3d.sweep.launchers.base import Job, JobState, Launcher

# What torch would load at the first step of every process, 0.8 s each time.
LAZY = ("torch._inductor", "torch._dynamo")
# Threads of the libraries below torch; set before any of them is loaded. Two processes of one thread each are
# faster than one of two.
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")

SERVED = ("fl3d.training.stage", "fl3d.sweep.launchers.server")
SERVER_TRIES = 3  # to start a process, where the server is killed
SERVER_SECONDS = 1.0  # between tries: three at once have met one server that had just been killed
SERVER_DIED = 255  # multiprocessing's code for a process whose fork server was killed


class _Worker:
    """A process that runs stages one after the other, and so keeps the frames that it has read.

    Args:
        process: started; it serves the other end.
        pipe: this end, through which stages go and their codes come back.
    """

    def __init__(self, process: mp.process.BaseProcess, pipe: Connection) -> None:
        self.process = process
        self._pipe = pipe
        self._is_free = True

    def give(self, folder: Path) -> bool:
        """Let it run a stage; False: it cannot, for it has another, failed or has gone."""
        if not (self._is_free and self.process.is_alive()):
            return False
        try:
            self._pipe.send(folder)
        except OSError:  # it went in this moment
            return False
        self._is_free = False
        return True

    def release(self) -> None:
        """Let it end when it has no stage."""
        self._pipe.close()

    def code(self) -> int | None:
        """How its stage has ended: 0 well, 1 by an error, others as ``Process.exitcode``; None: not yet."""
        with contextlib.suppress(EOFError, OSError):  # it has gone, which its exit code tells
            if self._pipe.poll():
                code = int(self._pipe.recv())
                self._is_free = code == 0
                return code
        return self.process.exitcode


class _Stage(Job):
    """A stage in a worker."""

    def __init__(self, worker: _Worker) -> None:
        self._worker = worker
        self._code: int | None = None

    def state(self) -> JobState:
        if self._code is None:
            self._code = self._worker.code()
        if self._code is None:
            return JobState.RUNNING
        if self._code == 0:
            return JobState.DONE
        return JobState.KILLED if self._code < 0 or self._code == SERVER_DIED else JobState.RAISED

    def cancel(self) -> None:
        if self.state().is_finished():
            return
        process = self._worker.process
        process.terminate()
        process.join(timeout=5)
        if process.exitcode is None:
            process.kill()
            process.join()


class LocalLauncher(Launcher):
    """Stages in processes that are forked from a server, which has loaded torch once.

    On a CPU a process runs stages one after the other as long as they end well, for frames that it has read it need not
    read again; on a card each stage has a process of its own, whose memory there is free when it ends.

    Args:
        slots: stages at once; None: one a core, or, on CUDA, ``per_card`` a card.
        device: that the stages run on.
        per_card: stages that share a card.
    """

    IS_HERE = True

    def __init__(self, slots: int | None = None, device: str = "cpu", per_card: int = 1) -> None:
        self._cards = _cards() if device.startswith("cuda") else []
        self.slots = slots or (
            len(self._cards) * per_card if self._cards else len(os.sched_getaffinity(0))
        )
        self._held: dict[int, _Stage] = {}
        self._workers: dict[int, _Worker] = {}  # by slot
        self._context = mp.get_context("forkserver")
        # All code is loaded now: what is edited while a sweep runs does not reach it.
        detectors = [
            f"fl3d.detectors.{module.name}"
            for module in pkgutil.iter_modules(fl3d.detectors.__path__)
        ]
        self._context.set_forkserver_preload([*SERVED, *LAZY, *detectors])
        for name in THREADS:
            os.environ.setdefault(name, "1")
        atexit.register(self.close)  # Python waits for its processes before it leaves

    def open(self) -> None:
        """Start the server; it loads while the sweep is being planned."""
        with (
            deaf_children()
        ):  # nor do the server's: Ctrl-C is for the parent, which then ends its stages
            forkserver.ensure_running()

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Start a process; what it prints goes to ``log.txt`` in the stage's folder."""
        taken = {slot for slot, job in self._held.items() if not job.state().is_finished()}
        slot = next(number for number in itertools.count() if number not in taken)
        worker = self._workers.get(slot)
        if worker is None or self._cards or not worker.give(folder):
            worker = self._workers[slot] = self._started(slot, folder)
        self._held[slot] = _Stage(worker)
        return self._held[slot]

    def _started(self, slot: int, folder: Path) -> _Worker:
        """A worker that has been given a stage; the server is started anew where it is killed in that moment.

        Raises:
            StageFailed: it was, again and again.
        """
        card = self._cards[slot % len(self._cards)] if self._cards else None
        for _ in range(SERVER_TRIES):
            own, other = mp.Pipe()
            process = self._context.Process(target=_serve, args=(other, card))
            with contextlib.suppress(EOFError, ConnectionError), without_main():
                process.start()
                other.close()
                worker = _Worker(process, own)
                if worker.give(folder):
                    return worker
            time.sleep(SERVER_SECONDS)
            self.open()
        raise StageFailed(
            f"{folder}: cannot be started: the server of its processes was killed {SERVER_TRIES} times"
        )

    def close(self) -> None:
        """Let the processes end that wait for another stage."""
        for worker in self._workers.values():
            worker.release()
        self._workers.clear()


def _cards() -> list[str]:
    """The CUDA devices that this process may use, as ``CUDA_VISIBLE_DEVICES`` names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [card for card in visible.split(",") if card]
    return [str(card) for card in range(max(1, torch.cuda.device_count()))]


def _serve(pipe: Connection, card: str | None) -> None:
    """Run the stages whose folders come through a pipe, until one fails or nobody holds the other end."""
    if card is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = card  # before this process first asks for a card
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where the server was started by somebody else
    end_with_parent()
    with contextlib.suppress(EOFError, OSError):
        while True:
            code = _run(pipe.recv())
            gc.collect()
            pipe.send(code)
            if code:
                sys.exit(code)


def _run(folder: Path) -> int:
    """Run a stage; what it prints goes to ``log.txt`` in its folder. 0, or 1 where it failed."""
    from fl3d.training.stage import run_stage

    with (
        contextlib.suppress(OSError),  # of the log itself, when the disk is full
        (folder / "log.txt").open("a", encoding="utf-8") as log,
        contextlib.redirect_stdout(log),
        contextlib.redirect_stderr(log),
    ):
        try:
            run_stage(folder)
        except Exception as error:
            print(f"{type(error).__name__}: {error}", file=log, flush=True)
        else:
            return 0
    return 1
