"""What choosing the best checkpoint is worth, and what of it is luck. Pure."""

from __future__ import annotations

from math import comb

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.reports.selection import select
from fl3d.reports.table import Cell, Column, Table

Float = NDArray[np.float64]
LAST = 5  # checkpoints that are averaged


def best_of_k(values: Float) -> Float:
    """Mean of the best of k values drawn without replacement: (N,) -> (N,) for k = 1 to N."""
    ordered, n = np.sort(values), len(values)
    means = []
    for k in range(1, n + 1):
        chances = np.array([comb(i, k - 1) / comb(n, k) for i in range(n)])  # that the i-th smallest is the best of k
        means.append(float(chances @ ordered))
    return np.array(means)


def split_half(means: Float, scores: Float) -> tuple[float, float]:
    """AP of the checkpoint that one half of the frames chooses: on that half, and on the other.

    Args:
        means: (2, R, C) what is chosen by, on each side of R halvings, of C checkpoints.
        scores: (2, R, C) what is reported.
    """
    best = means.argmax(axis=2)[..., None]
    return float(np.take_along_axis(scores, best, 2).mean()), float(np.take_along_axis(scores[::-1], best, 2).mean())


def honest_table(scores: pd.DataFrame, halved: pd.DataFrame, stages: str, notes: tuple[str, ...] = ()) -> Table:
    """Best beside last beside the mean of the last five, and what the best is worth on frames that did not choose.

    Args:
        scores: tidy.
        halved: ``trial``, ``chosen`` and ``other``: 3D AP moderate on the choosing half and on the other half.
        stages: where ``best`` looks, see ``selection.select``.
        notes: put below.
    """
    metric = "ap_3d/moderate"
    last, best = (select(scores, rule, stages).set_index("trial") for rule in ("last", "best"))
    inner = scores[scores["step"] > scores["first_own_step"]].sort_values("step") if stages == "last" else scores
    tail = inner.groupby("trial")[metric].apply(lambda own: own.tail(LAST).mean())
    sides = halved.set_index("trial")
    n = min(LAST, int(inner.groupby("trial").size().max()))
    rows = []
    frame = last.assign(best=best[metric], tail=tail, chosen=sides["chosen"], other=sides["other"])
    for (detector, gamma), own in frame.groupby(["detector", "gamma"]):
        mean = own[[metric, "best", "tail", "chosen", "other"]].mean()
        texts = [f"{mean[name]:.2f}" for name in (metric, "tail", "best", "chosen", "other")]
        optimism = f"{mean['chosen'] - mean['other']:+.2f}"
        rows.append((Cell(str(detector)), Cell(f"{gamma:g}"), *(Cell(text) for text in (*texts, optimism))))
    heads = {
        "last": "last",
        "last_five": f"mean of last {n}",
        "best": "best",
        "half": "best of a half, there",
        "other_half": "on the other half",
        "optimism": "optimism",
    }
    front = (Column("detector", "Detector"), Column("gamma", "γ"))
    columns = front + tuple(Column(key, head, "", True) for key, head in heads.items())
    caption = "Last, best and honest best: 3D AP moderate (R11) of the models of each trial"
    legend = (
        "Best by the mean of the three 3D APs; optimism: what the choosing half promises and the other does not keep"
    )
    among = sorted(inner.groupby("trial").size().unique())
    chosen = f"Best is chosen among {'/'.join(str(count) for count in among)} checkpoints of a trial."
    return Table("honest", caption, columns, tuple(rows), legend, (*notes, chosen))
