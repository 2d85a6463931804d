"""Sentences of the paper about its best models, Table IV: the gains there, and the steps. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from fl3d.papers.claim import Claim
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.reports.table import AP_COLUMNS, is_better

EPOCH = 3712  # steps: one for each training frame
CHOSEN = "ours: no verdict: checkpoint and γ were chosen on the frames that judge them"


def best_claim(ours: Sequence[bool] = (), of_last_stage: Sequence[bool] = ()) -> Claim:
    """Table IV: the focal loss improves all metrics of the best models.

    Ours is counted and not judged: under no effect the best of many checkpoints and of six gammas is better than the
    best of one gamma's checkpoints in most cells.

    Args:
        ours: whether each AP improves, of all checkpoints, see ``best_models.improvements``; none: no models.
        of_last_stage: likewise, of each trial's last stage.
    """
    printed = _improved(published_table("IV"))
    slip = "holds" if all(printed) else "false by one cell (VoxelNet 3D hard, 0.01)"
    shown = f"{_counted(ours)}; of the last stage alone {_counted(of_last_stage)}" if ours else ""
    return Claim(
        "§VI-A, Table IV",
        "metrics of the best models that γ > 0 improves",
        "all",
        _counted(printed),
        shown,
        f"{slip}; {CHOSEN}" if ours else slip,
    )


def _improved(printed: pd.DataFrame) -> list[bool]:
    """Of each printed AP of each detector, whether the model with a focal loss is better."""
    found = []
    for _, pair in printed.groupby("detector"):
        is_zero = pair["gamma"].astype(float) == 0
        zero, focal = pair[is_zero].iloc[0], pair[~is_zero].iloc[0]
        found += [is_better(float(focal[column]), float(zero[column])) for column in AP_COLUMNS]
    return found


def _counted(improved: Sequence[bool]) -> str:
    return f"{sum(improved)} of {len(improved)}"


def step_claims() -> list[Claim]:
    """Table IV prints steps in thousands: they are whole epochs of the training frames."""
    rows = [("Table IV", row) for row in published_table("IV").to_dict("records")]
    rows += [("Table IV, arXiv", row) for row in published_table("IV_arxiv").to_dict("records")]
    found: dict[tuple[str, str], Claim] = {}  # what both versions print is told once
    for where, row in rows:
        printed = float(str(row["step"]).rstrip("k")) * 1000
        epochs = round(printed / EPOCH)
        is_near = abs(epochs * EPOCH - printed) < 1000
        claim = Claim(
            where,
            f"step of the best {row['detector']}, γ = {row['gamma']}",
            str(row["step"]),
            f"{epochs} epochs = {epochs * EPOCH:,}",
            "",
            "printed correctly" if is_near else "printed wrong",
        )
        found.setdefault((str(row["detector"]), str(row["step"])), claim)
    return list(found.values())
