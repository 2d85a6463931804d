"""Processes on this machine, one torch thread each."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing as mp
import os
import pkgutil
import signal
import sys
import time
from multiprocessing import forkserver
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


class _Process(Job):
    def __init__(self, process: mp.process.BaseProcess) -> None:
        self._process = process

    def state(self) -> JobState:
        code = self._process.exitcode
        if code is None:
            return JobState.RUNNING
        if code == 0:
            return JobState.DONE
        return JobState.KILLED if code < 0 or code == SERVER_DIED else JobState.RAISED

    def cancel(self) -> None:
        self._process.terminate()
        self._process.join(timeout=5)
        if self._process.exitcode is None:
            self._process.kill()
            self._process.join()


class LocalLauncher(Launcher):
    """Each stage in a process of its own, forked from a server that has loaded torch once.

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
        self._held: dict[int, _Process] = {}
        self._context = mp.get_context("forkserver")
        # All code is loaded now: what is edited while a sweep runs does not reach it.
        detectors = [
            f"fl3d.detectors.{module.name}"
            for module in pkgutil.iter_modules(fl3d.detectors.__path__)
        ]
        self._context.set_forkserver_preload([*SERVED, *LAZY, *detectors])
        for name in THREADS:
            os.environ.setdefault(name, "1")

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
        card = self._cards[slot % len(self._cards)] if self._cards else None
        self._held[slot] = _Process(self._started(folder, card))
        return self._held[slot]

    def _started(self, folder: Path, card: str | None) -> mp.process.BaseProcess:
        """A process of the server's, which is started anew where it is killed in that moment.

        Raises:
            StageFailed: it was, again and again.
        """
        for _ in range(SERVER_TRIES):
            process = self._context.Process(target=_work, args=(folder, card))
            with contextlib.suppress(EOFError, ConnectionError), without_main():
                process.start()
                return process
            time.sleep(SERVER_SECONDS)
            self.open()
        raise StageFailed(
            f"{folder}: cannot be started: the server of its processes was killed {SERVER_TRIES} times"
        )


def _cards() -> list[str]:
    """The CUDA devices that this process may use, as ``CUDA_VISIBLE_DEVICES`` names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [card for card in visible.split(",") if card]
    return [str(card) for card in range(max(1, torch.cuda.device_count()))]


def _work(folder: Path, card: str | None) -> None:
    from fl3d.training.stage import run_stage

    if card is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = card  # before this process first asks for a card
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where the server was started by somebody else
    end_with_parent()
    code = 1
    with (
        contextlib.suppress(OSError),  # of the log itself, when the disk is full
        (folder / "log.txt").open("a", encoding="utf-8") as log,
        contextlib.redirect_stdout(log),
        contextlib.redirect_stderr(log),
    ):
        try:
            run_stage(folder)
            code = 0
        except Exception as error:
            print(f"{type(error).__name__}: {error}", file=log, flush=True)
    sys.exit(code)
