"""Sentences of the paper about the size of the loss's terms (§IV-B, §VI-A, appendix A). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fl3d.evaluation.intervals import interval
from fl3d.papers.claim import SEEDS_ALONE, Claim, over_seeds, seeds_in, too_few
from fl3d.papers.focal_loss.window_figures import Array

ORDER = 1.0  # powers of ten: what "the same order of magnitude" is taken for
ALIKE = "same order"
UNLIKE = "large imbalance"


@dataclass(frozen=True)
class Terms:
    """Terms of the loss of one training, weighed as they are added: means between checkpoints.

    Args:
        positive: classification of the positives, (C,).
        negative: of the negatives, (C,).
        regression: (C,).
    """

    positive: Array
    negative: Array
    regression: Array

    def of_positives(self) -> Array:
        """Powers of ten by which the positives' term is larger than the negatives', (C,)."""
        found: Array = np.log10(self.positive / self.negative)
        return found

    def of_classification(self) -> Array:
        """Powers of ten by which the classification is larger than the regression, (C,)."""
        found: Array = np.log10((self.positive + self.negative) / self.regression)
        return found


def loss_term_claims(
    fcn3d: Sequence[Terms], voxelnet: Sequence[Terms], original: Sequence[Terms]
) -> list[Claim]:
    """Which terms are of the same order of magnitude, throughout training.

    Args:
        fcn3d: of each seed of 3D-FCN under gamma = 0; none where there is no such model.
        voxelnet: likewise.
        original: of 3D-FCN under the original form of the loss, the left side of Eq. 7 to 11.
    """
    found = []
    for name, models in (("3D-FCN", fcn3d), ("VoxelNet", voxelnet)):
        found += [
            _claim("§VI-A", f"{name}: loss of positives over negatives", ALIKE, _positives(models)),
            _claim(
                "§VI-A", f"{name}: classification over regression", ALIKE, _classification(models)
            ),
        ]
    text = "3D-FCN, original loss"
    return [
        *found,
        _claim("§IV-B", f"{text}: positives over negatives", UNLIKE, _positives(original)),
        _claim(
            "appendix A",
            f"{text}: classification over regression",
            ALIKE,
            _classification(original),
        ),
    ]


def _positives(models: Sequence[Terms]) -> list[Array]:
    return [one.of_positives() for one in models]


def _classification(models: Sequence[Terms]) -> list[Array]:
    return [one.of_classification() for one in models]


def _claim(where: str, text: str, printed: str, powers: Sequence[Array]) -> Claim:
    """A ratio: each seed's is the mean of its powers of ten, so that each checkpoint counts alike."""
    if not powers:
        return Claim(where, text, printed, "", "", "")
    found = interval(over_seeds([float(one.mean()) for one in powers]))
    few = too_few(len(powers))
    shown = f"{10**found.value:.2f}"
    if not few:
        shown += f" [{10**found.low:.2f}, {10**found.high:.2f}] {SEEDS_ALONE}"
    every = np.concatenate(powers)
    span = f"{10 ** every.min():.2f} to {10 ** every.max():.2f} between checkpoints"
    if few:
        word = few
    elif found.is_within(ORDER):
        word = "within a factor of 10"
    elif found.low > ORDER or found.high < -ORDER:
        word = "apart by more than a factor of 10"
    else:
        word = "not distinguishable from a factor of 10"
    return Claim(
        where, text, printed, "", f"{shown}, {span}; {seeds_in(len(powers))}", f"ours: {word}"
    )
