"""While fl3d's libraries are loaded, Python need not look for garbage: there is much that is new, and none of it goes.

Looking for it took a seventh of a short command's time, and looking once more at the end as long again (measured on
``evaluate`` of 3769 frames, benchmarks/start.py). A command loads what it computes with when it has read its words, so
that ``--help`` and a slip are answered at once.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

from fl3d.core import interrupts


@contextmanager
def uncollected() -> Iterator[None]:
    """No look for garbage inside; for what ends soon, and makes no rings of large objects."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@contextmanager
def loading() -> Iterator[None]:
    """What a command computes with is imported inside; behind it there is something that a signal has to end."""
    with uncollected():
        yield
    interrupts.loaded()


def leave_quickly() -> None:
    """No last look for garbage when this process ends: the system takes its memory back at once."""
    atexit.register(gc.freeze)
