"""What choosing the best checkpoint is worth: choose on one half of the validation frames, report on the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import comb

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.samples import counted
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.bootstrap import resampled_aps
from fl3d.evaluation.protocol import DIFFICULTIES

HALVINGS = 100
Float = NDArray[np.float64]


def halved(compared: Iterable[Comparison], classes: Sequence[str]) -> tuple[float, float]:
    """3D AP moderate of the checkpoint that a half chooses, on it and on the other half.

    Args:
        compared: the checkpoints of a trial, held against the labels.
        classes: whose mean AP it is.

    Returns:
        means over halvings in both directions.
    """
    sides: NDArray[np.int32] | None = None
    means = []
    moderate = []
    for comparison in compared:
        if sides is None:
            sides = halves(len(comparison.gt))
        flat = sides.reshape(-1, sides.shape[2])
        aps = {level: _aps(comparison, classes, level, flat) for level in DIFFICULTIES}
        means.append(np.mean(list(aps.values()), axis=0))
        moderate.append(aps["moderate"])
    return split_half(np.stack(means, axis=-1), np.stack(moderate, axis=-1))


def _aps(
    comparison: Comparison, classes: Sequence[str], level: str, flat: NDArray[np.int32]
) -> Float:
    """3D AP on both sides of all halvings, the mean over classes that have ground truths: (2, R)."""
    cell = ("3d", level)
    own = [
        resampled_aps(comparison.matches(name, *cell), flat)[:, 0]
        for name in counted(comparison, cell, classes)
    ]
    return np.asarray(np.mean(own, axis=0)).reshape(2, HALVINGS)


def halves(n_frames: int) -> NDArray[np.int32]:
    """Which frames are on each side: (2, R, F) of 0 and 1."""
    rng = np.random.default_rng([0, n_frames])
    first = np.zeros((HALVINGS, n_frames), dtype=np.int32)
    for row in first:
        row[rng.permutation(n_frames)[: n_frames // 2]] = 1
    return np.stack([first, 1 - first])


def split_half(means: Float, scores: Float) -> tuple[float, float]:
    """AP of the checkpoint that one half of the frames chooses: on that half, and on the other.

    Args:
        means: (2, R, C) what is chosen by, on each side of R halvings, of C checkpoints.
        scores: (2, R, C) what is reported.
    """
    best = means.argmax(axis=2)[..., None]
    there = float(np.take_along_axis(scores, best, 2).mean())
    elsewhere = float(np.take_along_axis(scores[::-1], best, 2).mean())
    return there, elsewhere


def best_of_k(values: Float) -> Float:
    """Mean of the best of k values drawn without replacement: (N,) -> (N,) for k = 1 to N."""
    ordered = np.sort(values)
    n = len(values)
    means = []
    for k in range(1, n + 1):
        chances = np.array(
            [comb(i, k - 1) / comb(n, k) for i in range(n)]
        )  # that the i-th smallest is the best of k
        means.append(float(chances @ ordered))
    return np.array(means)


def best_of_k_checkpoints(scores: pd.DataFrame) -> pd.DataFrame:
    """Mean 3D AP moderate of the best of k checkpoints of a trial's last stage, seeds averaged.

    Those of a shared beginning are no choice between levels: all have them. A curve ends at the seed with the fewest
    checkpoints: beyond it the mean would be of other seeds, and could fall.

    Args:
        scores: tidy, with ``first_own_step``.

    Returns:
        a row for each group, level and k that every seed of the level has: ``best``.
    """
    parts = []
    last = scores[scores["step"] > scores["first_own_step"]]
    for (group, level, seed), own in last.groupby(["group", "level", "seed"], sort=False):
        best = best_of_k(own["ap_3d/moderate"].to_numpy())
        front = {"group": group, "level": level, "seed": seed}
        parts.append(pd.DataFrame(front | {"k": np.arange(1, len(best) + 1), "best": best}))
    every = pd.concat(parts, ignore_index=True)
    fewest = every.groupby(["group", "level", "seed"])["k"].max().groupby(["group", "level"]).min()
    places = pd.MultiIndex.from_frame(every[["group", "level"]])
    every = every[every["k"].to_numpy() <= fewest.reindex(places).to_numpy()]
    return every.groupby(["group", "level", "k"], sort=False)["best"].mean().reset_index()
