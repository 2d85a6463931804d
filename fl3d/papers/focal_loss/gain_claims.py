"""Sentences of the paper about gains: what was printed, what its own cells give, and what ours say. Pure.

A sentence names the largest or the smallest of many gains. Under no effect the largest of many noisy gains is above
zero and the smallest below, so their signs say nothing. What ours say comes from intervals of all these gains that hold
at once: the largest true gain then lies between the largest of their lower ends and the largest of their upper ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import pandas as pd

from fl3d.evaluation.intervals import Interval, Sample, joint_intervals
from fl3d.papers.claim import Claim, interval_text, seeds_in, too_few, word_of
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.focal_loss.tables import LAST_TABLES
from fl3d.reports.table import AP_COLUMNS

# Gains over gamma = 0 of one detector's last models, by gamma and AP column, ...
Gains = Mapping[tuple[float, str], Sample]
# ... and by average: R11, in which the paper prints, and R40, which has fewer recall steps and gives the words.
GainsByAverage = Mapping[str, Gains]
PRINTED_IN = "R11"
JUDGED_IN = "R40"
ROUNDED = 0.0501  # printed with one decimal


class Extreme(StrEnum):
    """Which of many gains a sentence names."""

    LARGEST_GAIN = "largest gain"
    SMALLEST_GAIN = "smallest gain"
    LARGEST_LOSS = "largest loss"

    def of_gains(self, found: Sequence[Interval]) -> Interval:
        """Where the extreme gain lies, of intervals that hold all at once."""
        pick = max if self is Extreme.LARGEST_GAIN else min
        return Interval(
            pick(one.value for one in found),
            pick(one.low for one in found),
            pick(one.high for one in found),
        )

    def as_told(self, gain: Interval) -> Interval:
        """A loss is a gain with its sign changed."""
        is_loss = self is Extreme.LARGEST_LOSS
        return Interval(-gain.value, -gain.high, -gain.low) if is_loss else gain

    def cells(self, word: str, n_cells: int) -> str:
        """Of how many of the gains a word is said where it is said of the extreme one."""
        is_of_all = word == ("smaller" if self is Extreme.LARGEST_GAIN else "larger")
        return f"{word} in {'all' if is_of_all else 'at least one of'} {n_cells} cells"


@dataclass(frozen=True)
class Sentence:
    """A sentence about the gains of last models over gamma = 0, in all metrics and difficulties of the tables.

    Args:
        where: section.
        says: which gain it names.
        detector: whose.
        gammas: over which it ranges.
        meant: these gammas in words.
        printed: its number; None: the paper is silent.
    """

    where: str
    says: Extreme
    detector: str
    gammas: tuple[float, ...]
    meant: str
    printed: float | None

    @property
    def text(self) -> str:
        """In our words."""
        return f"{self.says} of {self.detector} for {self.meant}"


LARGEST, SMALLEST, LOSS = Extreme
TO_TWO = (0.1, 0.2, 0.5, 1.0, 2.0)
ODD = (0.1, 0.5, 1.0)
EVEN = (0.2, 2.0)
SENTENCES = (
    Sentence("abstract, §VI-A", LARGEST, "3D-FCN", TO_TWO, "0 < γ ≤ 2", 11.2),
    Sentence("§VI-A", SMALLEST, "3D-FCN", TO_TWO, "0 < γ ≤ 2", 0.3),
    Sentence("§VI, arXiv", SMALLEST, "3D-FCN", TO_TWO, "0 < γ ≤ 2", 0.5),
    Sentence("§VI-A", SMALLEST, "VoxelNet", ODD, "γ = 0.1, 0.5, 1", 0.6),
    Sentence("§VI-A", LARGEST, "VoxelNet", ODD, "γ = 0.1, 0.5, 1", 9.1),
    Sentence("§VI-A", LOSS, "VoxelNet", EVEN, "γ = 0.2, 2", 2.7),
    Sentence("(not said)", LOSS, "VoxelNet", (5.0,), "γ = 5", None),
)


def gain_claims(ours: Mapping[str, GainsByAverage], looks: tuple[int, ...] = ()) -> list[Claim]:
    """The claims about gains of last models (abstract, §VI-A), each by intervals that hold for all its cells at once.

    Args:
        ours: by detector, gains of our last models.
        looks: numbers of seeds after which they were looked at, see ``evaluation.intervals.member_alpha``.
    """
    return [_claim(sentence, ours.get(sentence.detector, {}), looks) for sentence in SENTENCES]


def _claim(sentence: Sentence, ours: GainsByAverage, looks: tuple[int, ...]) -> Claim:
    theirs = published_gain(sentence)
    found = {
        average: {place: gain for place, gain in gains.items() if place[0] in sentence.gammas}
        for average, gains in ours.items()
    }
    slip = "" if sentence.printed is None else _slip(sentence.printed, theirs)
    shown, said = _ours(sentence, found, looks) if any(found.values()) else ("", "")
    return Claim(
        sentence.where,
        sentence.text + _met(sentence, found.get(JUDGED_IN, {})),
        "" if sentence.printed is None else f"{sentence.printed:g}",
        f"{theirs:.2f}",
        shown,
        "; ".join(part for part in (slip, said) if part),
    )


@cache  # several sentences are about it
def published_last(detector: str) -> pd.DataFrame:
    """Published last models: APs as numbers, by gamma."""
    frame = published_table(LAST_TABLES[detector].number)
    return frame[list(AP_COLUMNS)].astype(float).set_axis(frame["gamma"].astype(float), axis=0)


def published_gain(sentence: Sentence) -> float:
    """What a sentence names, of the paper's own cells."""
    aps = published_last(sentence.detector)
    gains = (aps.loc[list(sentence.gammas)] - aps.loc[0.0]).to_numpy().ravel()
    found = sentence.says.of_gains([Interval(gain, gain, gain) for gain in gains])
    return float(sentence.says.as_told(found).value)


def _slip(printed: float, recomputed: float) -> str:
    if abs(recomputed - printed) < ROUNDED:
        return "printed correctly"
    return "printed cut off, not rounded" if 0 < recomputed - printed < 0.1 else "printed wrong"


def _met(sentence: Sentence, gains: Gains) -> str:
    """Which of the sentence's gammas ours are of, where they are not all."""
    met = {gamma for gamma, _ in gains}
    if not met or met == set(sentence.gammas):
        return ""
    return f" (ours: γ = {', '.join(f'{gamma:g}' for gamma in sorted(met))})"


def _ours(sentence: Sentence, ours: GainsByAverage, looks: tuple[int, ...]) -> tuple[str, str]:
    """The gain that a sentence names in ours, and what is said of it."""
    says = sentence.says
    found = {
        average: says.of_gains(joint_intervals(list(gains.values()), looks=looks))
        for average, gains in ours.items()
    }
    counts = sorted({len(gain.values) for gain in ours[JUDGED_IN].values()})
    over = seeds_in(counts[0]) if len(counts) == 1 else f"{counts[0]} to {seeds_in(counts[-1])}"
    shown = [f"{average} {interval_text(says.as_told(one))}" for average, one in found.items()]
    text = "; ".join([*shown, over])
    few = too_few(counts[0])
    if few:
        return text, f"ours: {few}"
    word = word_of(found[JUDGED_IN])
    if found[JUDGED_IN].excludes_zero:
        word = says.cells(word, len(ours[JUDGED_IN]))
    parts = [f"ours: {word} ({JUDGED_IN})"]
    if sentence.printed is not None:
        own = says.as_told(found[PRINTED_IN])
        side = "within" if own.low <= sentence.printed <= own.high else "outside"
        parts.append(f"{sentence.printed:g} lies {side} ours ({PRINTED_IN})")
    return text, "; ".join(parts)
