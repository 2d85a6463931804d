"""How far a long piece of work is: on a terminal a bar, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from tqdm import tqdm

from fl3d.core.streams import is_terminal

LINE_SECONDS = 10.0  # between lines where there is no terminal; shorter work says nothing
BAR_SECONDS = 1.0  # before a bar is drawn where there is one


class Advance(Protocol):
    """Says that more of the work is done."""

    def __call__(self, count: int, /) -> object:
        """Count."""


@contextmanager
def counted(title: str, total: int | None, unit: str) -> Iterator[Advance]:
    """Show on standard error how much of some work is done, and about how long the rest takes.

    Args:
        title: what is done.
        total: how many there are; None: nobody knows.
        unit: what is counted, in the singular.
    """
    if is_terminal(sys.stderr):
        with tqdm(
            total=total, desc=title, unit=unit, leave=False, dynamic_ncols=True, delay=BAR_SECONDS
        ) as bar:
            yield bar.update
        return
    yield _Lines(title, total, unit)


class _Lines:
    def __init__(self, title: str, total: int | None, unit: str) -> None:
        self.title, self.total, self.unit = title, total, unit
        self.done = 0
        self.started = self.told = time.monotonic()

    def __call__(self, count: int, /) -> None:
        self.done += count
        now = time.monotonic()
        if now - self.told >= LINE_SECONDS:
            self.told = now
            print(self._text(now - self.started), file=sys.stderr, flush=True)

    def _text(self, seconds: float) -> str:
        if self.total is None:
            return f"{self.title}: {self.done:,} {self.unit}s"
        left = tqdm.format_interval(seconds * max(0, self.total - self.done) / max(1, self.done))
        return f"{self.title}: {self.done:,} of {self.total:,} {self.unit}s, about {left} left"
