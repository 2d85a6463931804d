"""A sentence of a document that states a number or an order, and the table of them all. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fl3d.evaluation.intervals import Interval, Sample
from fl3d.evaluation.verdicts import FEWEST
from fl3d.reports.table import Cell, Column, Table
from fl3d.reports.verdicts import ONE_SEED

DASH = "–"
HEADS = ("where", "claim", "printed", "from its own cells", "ours", "verdict")
NO_DIFFERENCE = "not distinguishable from 0"
SEEDS_ALONE = "over seeds"  # behind an interval that knows nothing of frames


@dataclass(frozen=True)
class Claim:
    """One sentence.

    Args:
        where: section or table.
        text: of the claim, in our words.
        printed: as the document prints it.
        recomputed: from the document's own cells or networks; empty where that cannot be.
        ours: from our store; empty where it holds nothing for it.
        verdict: of both.
    """

    where: str
    text: str
    printed: str
    recomputed: str
    ours: str
    verdict: str


def claims_table(
    claims: Sequence[Claim],
    notes: tuple[str, ...] = (),
    name: str = "claims",
    caption: str = "Claims of the paper that state a number",
) -> Table:
    """All claims of a document, a row each.

    Args:
        claims: in the document's order.
        notes: put below.
        name: of the table's files.
        caption: of the table.
    """
    columns = tuple(Column(head.replace(" ", "_"), head) for head in HEADS)
    rows = []
    for claim in claims:
        texts = (claim.where, claim.text, claim.printed, claim.recomputed)
        rows.append(tuple(Cell(text or DASH) for text in (*texts, claim.ours, claim.verdict)))
    return Table(name, caption, columns, tuple(rows), "", notes)


def over_seeds(values: Sequence[float]) -> Sample:
    """A number of each seed, that frames are not resampled for."""
    return Sample(np.array(values), np.array([np.mean(values)]))


def is_over_seeds(sample: Sample) -> bool:
    """Whether a number was not resampled over frames, see ``over_seeds``."""
    return len(sample.draws) == 1


def too_few(n_seeds: int) -> str:
    """Why there is no verdict from so many seeds of training; empty where there is one."""
    if n_seeds >= FEWEST:
        return ""
    return ONE_SEED if n_seeds == 1 else f"no verdict before {FEWEST} seeds"


def word_of(difference: Interval) -> str:
    """On which side of zero a difference lies: ``larger``, ``smaller``, or neither."""
    if not difference.excludes_zero:
        return NO_DIFFERENCE
    return "larger" if difference.low > 0 else "smaller"


def interval_text(found: Interval, digits: int = 2) -> str:
    """A difference and its interval: ``+0.45 [-0.31, +1.20]``."""
    low, high = f"{found.low:+.{digits}f}", f"{found.high:+.{digits}f}"
    return f"{found.value:+.{digits}f} [{low}, {high}]"


def seeds_in(n_seeds: int) -> str:
    """So many seeds, in words."""
    return "1 seed" if n_seeds == 1 else f"{n_seeds} seeds"
