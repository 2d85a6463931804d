"""Which sweeps of the files in ``sweeps/`` were run on some data at some size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from fl3d.config.compose import CONF, compose_config
from fl3d.config.settings import read_settings
from fl3d.core.errors import StoreError
from fl3d.papers.base import Feeding, PaperTable
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import is_stored, open_sweep

PLACES = ("data", "profile", "store", "results")  # keys that say where a sweep lies


def place_words(words: Sequence[str]) -> list[str]:
    """The words that say where a sweep lies, not which it is."""
    return [
        word for word in words if word.lstrip("+").partition("=")[0].partition(".")[0] in PLACES
    ]


def stored_sweeps(words: Sequence[str], published: Path | None) -> list[FinishedSweep]:
    """The sweeps of ``sweeps/`` that were run, or of which a results folder holds scores.

    Args:
        words: that say where.
        published: folder of results that were published; None: none.
    """
    places = place_words(words)
    base = read_settings(compose_config(places))
    found = []
    for path in sorted((CONF / "sweep").glob("*.yaml")):
        # Without composing its config, which takes a while: sweep files are called as their sweeps.
        if not is_stored(replace(base, sweep=replace(base.sweep, name=path.stem)), published):
            continue
        settings = read_settings(compose_config([*places, f"+sweep={path.stem}"]))
        try:
            found.append(open_sweep(settings, None, published))
        except StoreError:  # planned, and none of its trials is done
            continue
    return found


def feeding(sweep: FinishedSweep, words: Sequence[str], published: Path | None) -> Feeding:
    """What finds all sweeps that feed a joint table: those on the same data and size, under the same protocol.

    Args:
        sweep: one of them.
        words: that say where they lie.
        published: see ``stored_sweeps``.
    """
    return feeding_among(sweep, cache(lambda: stored_sweeps(words, published)))


def feeding_among(sweep: FinishedSweep, others: Callable[[], Sequence[FinishedSweep]]) -> Feeding:
    """What finds those of some sweeps that feed a joint table: those under the same protocol.

    Args:
        sweep: one of them, which comes first.
        others: gives the others, and perhaps this one too; asked when a joint table is.
    """

    def find(table: PaperTable) -> Sequence[FinishedSweep]:
        every = [sweep, *(other for other in others() if other.name != sweep.name)]
        return [
            other
            for other in every
            if table.name in other.settings.sweep.tables and other.protocol.id == sweep.protocol.id
        ]

    return find
