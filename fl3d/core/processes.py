"""Processes that work for a command: they end with it, whatever ends it."""

from __future__ import annotations

import multiprocessing as mp
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import forkserver
from typing import Any

from fl3d.core.interrupts import deaf_children, end_with_parent

# What a pool says of a killed worker, or server of workers.
KILLED = (BrokenProcessPool, EOFError, ConnectionError)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def without_main() -> Iterator[None]:
    """Processes that are started within do not load the program that calls fl3d; they need nothing of it.

    Else multiprocessing has each of them run that program up to its ``if __name__ == "__main__":``, and a script
    without that line, such as a few calls of fl3d's, would start itself over and over.
    """
    own = sys.modules["__main__"]
    kept: dict[str, Any] = {
        name: own.__dict__[name] for name in ("__spec__", "__file__") if name in own.__dict__
    }
    own.__spec__ = None
    own.__dict__.pop("__file__", None)
    try:
        yield
    finally:
        own.__dict__.update(kept)


@contextmanager
def pool(
    workers: int,
    begin: Callable[..., object] | None = None,
    given: tuple[Any, ...] = (),
    loaded: Sequence[str] = (),
) -> Iterator[ProcessPoolExecutor]:
    """Processes that take what is submitted to them; where the block ends by an exception they are ended at once.

    Args:
        workers: how many.
        begin: called in each when it starts.
        given: to ``begin``.
        loaded: modules that the server of the workers loads once for all, where it does not run yet.
    """
    before = set(mp.active_children())
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(list(loaded))
    with deaf_children():
        forkserver.ensure_running()
    executor = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(begin, given)
    )
    try:
        with without_main():  # it starts them as they are needed
            yield executor
    except BaseException:  # Ctrl-C too: nobody waits for what a worker has in hand
        for worker in set(mp.active_children()) - before:
            worker.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _begin(begin: Callable[..., object] | None, given: tuple[Any, ...]) -> None:
    end_with_parent()
    if begin is not None:
        begin(*given)
