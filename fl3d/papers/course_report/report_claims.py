"""What a sentence of the report is worth: by its own cells, and by ours. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fl3d.analysis.samples import pair_seeds
from fl3d.evaluation.intervals import Sample, joint_intervals
from fl3d.papers.claim import SEEDS_ALONE, Claim, interval_text, is_over_seeds, seeds_in, too_few
from fl3d.papers.course_report.cells import Cells
from fl3d.papers.course_report.sentences import (
    DEFAULT,
    LEVELS,
    Place,
    Says,
    Sentence,
    printed_cell,
)

LISTED = 5  # differences that are told one by one; of more the smallest and the largest
IMPROVED = 2  # of three levels: what the report calls a success


def claim_of(sentence: Sentence, ours: Cells) -> Claim:
    """A sentence beside its own cells, and beside ours where both sides of any difference are there."""
    pairs = [(over, column) for over in sentence.over for column in sentence.columns]
    theirs = [
        printed_cell(sentence.row, column) - printed_cell(over, column) for over, column in pairs
    ]
    family = [
        gain
        for over, column in pairs
        if (gain := difference(ours, sentence.row, over, column)) is not None
    ]
    shown, word = _ours(sentence, family) if family else ("", "")
    own = _slip(sentence, theirs)
    return Claim(
        sentence.where,
        sentence.text,
        sentence.printed,
        _listed([f"{one:+.{_digits(sentence)}f}" for one in theirs], theirs),
        shown,
        "; ".join(part for part in (own, word) if part),
    )


def difference(ours: Cells, row: Place, over: Place, column: str) -> Sample | None:
    """By how much one of our rows lies above another, over the seeds that both have; None: they have none."""
    side, base = ours.get((row, column), {}), ours.get((over, column), {})
    return pair_seeds(side, base)[1] if set(side) & set(base) else None


def _slip(sentence: Sentence, theirs: Sequence[float]) -> str:
    if sentence.says is Says.ALIKE:
        return "no bound was printed"
    n_held = sum(sentence.says.holds(one, sentence.than) for one in theirs)
    return "holds in its cells" if n_held == len(theirs) else f"holds in {n_held} of {len(theirs)}"


def _ours(sentence: Sentence, family: Sequence[Sample]) -> tuple[str, str]:
    """Differences of ours and what is said of them; words are of the differences less ``than``."""
    digits = _digits(sentence)
    means = [float(np.mean(one.values)) for one in family]
    n_seeds = min(len(one.values) for one in family)
    few = sentence.chosen or too_few(n_seeds)
    if few:
        told = _listed([f"{one:+.{digits}f}" for one in means], means)
        return f"{told}; {seeds_in(n_seeds)}", f"ours: {few}"
    found = joint_intervals(family)
    told = _listed([interval_text(one, digits) for one in found], means)
    counts = {
        "larger": sum(one.low > sentence.than for one in found),
        "smaller": sum(one.high < sentence.than for one in found),
    }
    told += f" {SEEDS_ALONE}" if any(is_over_seeds(one) for one in family) else ""
    than = f" than {sentence.than:g}" if sentence.than else ""
    words = f"larger{than} in {counts['larger']}, smaller in {counts['smaller']}"
    return f"{told}; {seeds_in(n_seeds)}", f"ours: {words} of {len(found)} cells"


def _digits(sentence: Sentence) -> int:
    return 3 if sentence.is_recall else 2


def _listed(texts: Sequence[str], values: Sequence[float]) -> str:
    if len(texts) <= LISTED:
        return ", ".join(texts)
    ends = (int(np.argmin(values)), int(np.argmax(values)))
    return " to ".join(texts[place] for place in ends)


def only_change_claim(settings: Mapping[str, Place], ours: Cells) -> Claim:
    """The one setting of Frustum ConvNet's first stage that is better than the default at two levels or more.

    Args:
        settings: rows of Table 6 by what they are called.
        ours: our cells.
    """
    theirs = [name for name, row in settings.items() if _improves(row)]
    family = {
        (name, column): gain
        for name, row in settings.items()
        for column in LEVELS
        if (gain := difference(ours, row, DEFAULT, column)) is not None
    }
    shown = verdict = ""
    if family:
        n_seeds = min(len(one.values) for one in family.values())
        means = {place: float(np.mean(one.values)) for place, one in family.items()}
        shown = f"{_named(_at_two({place for place, one in means.items() if one > 0}))}; {seeds_in(n_seeds)}"
        found = dict(zip(family, joint_intervals(list(family.values())), strict=True))
        larger = _at_two({place for place, one in found.items() if one.low > 0})
        few = too_few(n_seeds)
        verdict = f"; ours: {few}" if few else f"; ours: larger at two levels: {_named(larger)}"
    return Claim(
        "§3.2.2",
        "Frustum ConvNet: changes that improve on the default at two levels or more",
        "α = 0.3 alone",
        _named(theirs),
        shown,
        ("holds in its cells" if theirs == ["Alpha = 0.3"] else "does not hold") + verdict,
    )


def _improves(row: Place) -> bool:
    better = [printed_cell(row, column) > printed_cell(DEFAULT, column) for column in LEVELS]
    return sum(better) >= IMPROVED


def _at_two(places: set[tuple[str, str]]) -> list[str]:
    names = [name for name, _ in places]
    return sorted({name for name in names if names.count(name) >= IMPROVED})


def _named(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
