"""Sentences of the paper about which windows carry the loss (§VI-B, Figure 4). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fl3d.evaluation.intervals import Interval, interval
from fl3d.papers.claim import (
    SEEDS_ALONE,
    Claim,
    interval_text,
    over_seeds,
    seeds_in,
    too_few,
    word_of,
)
from fl3d.papers.focal_loss.window_figures import Array, cumulative_loss

WHERE = "§VI-B, Fig. 4"
HARDEST = 0.15  # the share of windows that the paper speaks of
FEW = 0.01  # what "a small fraction" is taken for
MOST = 0.9  # what "the vast majority" is taken for
FOCAL = 2.0  # the gamma that the paper speaks of
POINTS = np.linspace(0, 1, 1001)  # at which two curves are compared


@dataclass(frozen=True)
class Carried:
    """Who carries the loss of one model, recomputed from its posteriors under gamma = 0 and gamma = 2.

    Args:
        hardest: share of the positives' loss on their hardest 15 %, under both.
        few: share of the negatives' loss on their hardest 1 % under gamma = 2.
        apart: largest distance of the positives' curve from the negatives' under gamma = 0.
        moved: area between the curves of both gammas: of the positives, of the negatives.
        parted: largest distance between the negatives' curves of both gammas.
    """

    hardest: tuple[float, float]
    few: float
    apart: float
    moved: tuple[float, float]
    parted: float


def carried(positive: Array, negative: Array) -> Carried:
    """Who carries the loss of a model, by its windows.

    Args:
        positive: logits, (P,).
        negative: logits, (N,).
    """
    positives, negatives = (
        [cumulative_loss(logits, sign, gamma, POINTS) for gamma in (0.0, FOCAL)]
        for logits, sign in ((positive, 1), (negative, -1))
    )
    base, focal = (_hardest(curve, HARDEST) for curve in positives)
    return Carried(
        hardest=(base, focal),
        few=_hardest(negatives[1], FEW),
        apart=_distance(positives[0], negatives[0]),
        moved=(_area(positives), _area(negatives)),
        parted=_distance(*negatives),
    )


def _hardest(curve: Array, share: float) -> float:
    """What the hardest share of windows carries."""
    return float(1 - np.interp(1 - share, POINTS, curve))


def _distance(one: Array, other: Array) -> float:
    """Largest of two curves from each other."""
    return float(np.abs(one - other).max())


def _area(curves: Sequence[Array]) -> float:
    """Between the curve of gamma = 0 and that of gamma = 2."""
    base, focal = curves
    return float(np.trapezoid(base - focal, POINTS))


def concentration_claims(fcn3d: Sequence[Carried], voxelnet: Sequence[Carried]) -> list[Claim]:
    """The six sentences, of each detector's best focal model.

    Args:
        fcn3d: of each seed of 3D-FCN; none where there is no such model.
        voxelnet: likewise.
    """
    return [
        _more_on_hardest(fcn3d),
        _alike(fcn3d),
        _from_few(fcn3d),
        _moves_more(fcn3d, "3D-FCN", "negatives"),
        _alike_under_both(voxelnet),
        _moves_more(voxelnet, "VoxelNet", "positives"),
    ]


def _more_on_hardest(models: Sequence[Carried]) -> Claim:
    text = f"more of the loss of 3D-FCN's positives lies on their hardest 15 % under γ = {FOCAL:g}"
    ends = [(one.hardest[0], one.hardest[1]) for one in models]
    shown = "" if not ends else "{:.0%} to {:.0%}".format(*np.mean(ends, axis=0))
    return _difference(text, "more", shown, [focal - base for base, focal in ends])


def _alike(models: Sequence[Carried]) -> Claim:
    text = "largest distance between the curves of 3D-FCN's positives and negatives under γ = 0"
    return _told(text, "quite similar", [one.apart for one in models], "no bound was printed")


def _alike_under_both(models: Sequence[Carried]) -> Claim:
    text = f"largest distance between the curves of VoxelNet's negatives under γ = 0 and {FOCAL:g}"
    return _told(text, "quite similar", [one.parted for one in models], "no bound was printed")


def _from_few(models: Sequence[Carried]) -> Claim:
    text = f"share of the loss of 3D-FCN's negatives on their hardest 1 % under γ = {FOCAL:g}"
    values = [one.few for one in models]
    word = ""
    if values:
        found = interval(over_seeds(values))
        is_apart = not found.low <= MOST <= found.high
        side = "above" if found.low > MOST else "below"
        word = f"{side} {MOST:.0%}" if is_apart else f"not distinguishable from {MOST:.0%}"
    return _told(text, "the vast majority", values, word)


def _moves_more(models: Sequence[Carried], detector: str, which: str) -> Claim:
    """Under which windows' curve the area changes more."""
    other = "positives" if which == "negatives" else "negatives"
    text = f"γ = {FOCAL:g} moves the curve of {detector}'s {which} by more than that of its {other}"
    ends = [one.moved if which == "positives" else one.moved[::-1] for one in models]
    shown = "" if not ends else "area {:.2f} against {:.2f}".format(*np.mean(ends, axis=0))
    return _difference(text, "stronger", shown, [own - others for own, others in ends])


def _difference(text: str, printed: str, shown: str, values: Sequence[float]) -> Claim:
    """A sentence that says that something is larger."""
    if not values:
        return Claim(WHERE, text, printed, "", "", "")
    few = too_few(len(values))
    if few:
        return Claim(WHERE, text, printed, "", f"{shown}; {seeds_in(len(values))}", f"ours: {few}")
    found = interval(over_seeds(values))
    ours = f"{shown}: {interval_text(found)} {SEEDS_ALONE}; {seeds_in(len(values))}"
    return Claim(WHERE, text, printed, "", ours, f"ours: {word_of(found)}")


def _told(text: str, printed: str, values: Sequence[float], word: str) -> Claim:
    """A sentence about a share."""
    if not values:
        return Claim(WHERE, text, printed, "", "", "")
    few = too_few(len(values))
    shown = f"{np.mean(values):.0%}" if few else _share_text(interval(over_seeds(values)))
    return Claim(
        WHERE, text, printed, "", f"{shown}; {seeds_in(len(values))}", f"ours: {few or word}"
    )


def _share_text(found: Interval) -> str:
    return f"{found.value:.0%} [{found.low:.0%}, {found.high:.0%}] {SEEDS_ALONE}"
