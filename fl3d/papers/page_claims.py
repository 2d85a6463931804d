"""The documents' claims, beside what the sweeps of a page give, and those that feed joint tables with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fl3d.analysis.contributions import Contributions
from fl3d.core.errors import DataError, StoreError
from fl3d.papers.registry import PAPERS, tables_named
from fl3d.papers.stored import feeding
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep


def claims_of_papers(
    made: Mapping[str, Contributions], words: Sequence[str], published: Path | None
) -> list[Table]:
    """A table for each paper that these sweeps say something of.

    Args:
        made: what the trials of the page's sweeps contribute, by the sweeps' names.
        words: that say where they lie.
        published: folder of results that were published, for joint tables; None: none.
    """
    sources = [*made.values(), *_feeders(made, words, published)]
    tables = [paper.claims(sources) for paper in PAPERS if paper.claims is not None]
    return [table for table in tables if table is not None]


def _feeders(
    made: Mapping[str, Contributions], words: Sequence[str], published: Path | None
) -> list[Contributions]:
    """Sweeps that are not on the page and feed a joint table with one that is, where they can be looked at."""
    found: dict[str, FinishedSweep] = {}
    for source in made.values():
        find = feeding(source.sweep, words, published)
        for table in tables_named(source.sweep.settings.sweep.tables):
            if table.is_joint:
                found |= {one.name: one for one in find(table)}
    return [
        Contributions(one) for name, one in found.items() if name not in made and _is_at_hand(one)
    ]


def _is_at_hand(sweep: FinishedSweep) -> bool:
    """Whether detections and labels are there; a joint table, which needs scores alone, says what it is made of."""
    try:
        return sweep.is_from_store and len(sweep.validation.ids) > 0
    except (DataError, StoreError):
        return False
