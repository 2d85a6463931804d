"""Sentences of the paper about gains: what was printed, what its own cells give, and what ours do. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.focal_loss.tables import LAST_TABLES
from fl3d.reports.levels import is_better
from fl3d.reports.table import AP_COLUMNS, Cell, Column, Table

DASH = "–"


@dataclass(frozen=True)
class Claim:
    """One sentence.

    Args:
        where: section or table.
        text: of the claim, in our words.
        printed: as the paper prints it.
        recomputed: from the paper's own cells or networks; empty where that cannot be.
        ours: from our store; empty where it holds nothing for it.
        verdict: of both.
    """

    where: str
    text: str
    printed: str
    recomputed: str
    ours: str
    verdict: str


def claims_table(claims: Sequence[Claim], notes: tuple[str, ...] = ()) -> Table:
    """All claims, a row each."""
    heads = ("where", "claim", "printed", "from its own cells", "ours", "verdict")
    columns = tuple(Column(head.replace(" ", "_"), head) for head in heads)
    rows = tuple(
        tuple(
            Cell(text or DASH)
            for text in (c.where, c.text, c.printed, c.recomputed, c.ours, c.verdict)
        )
        for c in claims
    )
    return Table("claims", "Claims of the paper that state a number", columns, rows, "", notes)


def published_last(detector: str) -> pd.DataFrame:
    """Published last models: APs as numbers, by gamma."""
    frame = published_table(LAST_TABLES[detector].number)
    return frame[list(AP_COLUMNS)].astype(float).set_axis(frame["gamma"].astype(float), axis=0)


def gains_over_zero(aps: pd.DataFrame, gammas: Sequence[float]) -> pd.DataFrame:
    """Gains of some gammas over gamma = 0: a row a gamma, a column a metric; empty without gamma = 0."""
    if 0.0 not in aps.index:
        return aps.iloc[:0]
    return aps.loc[[g for g in aps.index if g in gammas]] - aps.loc[0.0]


def gain_claims(ours: dict[str, pd.DataFrame]) -> list[Claim]:
    """The claims about gains of last models (abstract, §VI-A).

    Args:
        ours: by detector, APs of our last models by gamma, columns as ``AP_COLUMNS``.
    """
    found = []
    for where, text, detector, gammas, sign, printed in (
        (
            "abstract, §VI-A",
            "largest gain of 3D-FCN for 0 < γ ≤ 2",
            "3D-FCN",
            (0.1, 0.2, 0.5, 1, 2),
            1,
            11.2,
        ),
        ("§VI-A", "smallest gain of 3D-FCN for 0 < γ ≤ 2", "3D-FCN", (0.1, 0.2, 0.5, 1, 2), 0, 0.3),
        (
            "§VI, arXiv",
            "smallest gain of 3D-FCN for 0 < γ ≤ 2",
            "3D-FCN",
            (0.1, 0.2, 0.5, 1, 2),
            0,
            0.5,
        ),
        (
            "§VI-A",
            "smallest gain of VoxelNet for γ = 0.1, 0.5, 1",
            "VoxelNet",
            (0.1, 0.5, 1),
            0,
            0.6,
        ),
        (
            "§VI-A",
            "largest gain of VoxelNet for γ = 0.1, 0.5, 1",
            "VoxelNet",
            (0.1, 0.5, 1),
            1,
            9.1,
        ),
        ("§VI-A", "largest loss of VoxelNet for γ = 0.2, 2", "VoxelNet", (0.2, 2), -1, 2.7),
        ("(not said)", "largest loss of VoxelNet for γ = 5", "VoxelNet", (5,), -1, None),
    ):
        theirs = _extreme(gains_over_zero(published_last(detector), gammas), sign)
        own = (
            _extreme(gains_over_zero(ours.get(detector, pd.DataFrame()), gammas), sign)
            if detector in ours
            else None
        )
        slip = "" if printed is None else _slip(printed, theirs)
        verdict = "; ".join(part for part in (slip, _ours(own, sign)) if part)
        shown = "" if printed is None else f"{printed:g}"
        own = None if own is None or pd.isna(own) else own
        met = [g for g in gammas if detector in ours and g in ours[detector].index]
        text += (
            ""
            if own is None or len(met) == len(gammas)
            else f" (ours: γ = {', '.join(f'{g:g}' for g in met)})"
        )
        found.append(
            Claim(where, text, shown, f"{theirs:.2f}", "" if own is None else f"{own:.2f}", verdict)
        )
    return found


def _extreme(gains: pd.DataFrame, sign: int) -> float:
    """The largest gain (1), the smallest (0) or the largest loss (-1), over rows and metrics; NaN for none."""
    if gains.empty:
        return float("nan")
    values = gains.to_numpy()
    return float({1: values.max(), 0: values.min(), -1: -values.min()}[sign])


def _slip(printed: float, recomputed: float) -> str:
    if abs(recomputed - printed) < 0.0501:
        return "printed correctly"
    return "printed cut off, not rounded" if 0 < recomputed - printed < 0.1 else "printed wrong"


def _ours(own: float | None, sign: int) -> str:
    if own is None:
        return ""
    if sign == -1:
        return "lower in ours too" if own > 0 else "not lower in ours"
    return "higher in ours too" if own > 0 else "lower in ours"


def best_claim(ours: pd.DataFrame) -> Claim:
    """Table IV: the focal loss improves all metrics of the best models.

    Args:
        ours: see ``tables.best_pairs``; APs in its columns.
    """
    theirs = published_table("IV")
    counts = []
    for frame, columns in ((theirs, list(AP_COLUMNS)), (ours, list(AP_COLUMNS.values()))):
        better = total = 0
        for _, pair in frame.groupby("detector"):
            zero, focal = (
                pair[pair["gamma"].astype(float) == 0],
                pair[pair["gamma"].astype(float) > 0],
            )
            if len(zero) and len(focal):
                wins = [is_better(float(focal.iloc[0][c]), float(zero.iloc[0][c])) for c in columns]
                better, total = better + sum(wins), total + len(columns)
        counts.append((better, total))
    (a, n), (b, m) = counts
    verdict = "false by one cell (VoxelNet 3D hard, 0.01)" if a < n else "holds"
    verdict += f"; ours: {'all' if b == m else 'not all'}" if m else ""
    ours_text = f"{b} of {m}" if m else ""
    return Claim(
        "§VI-A, Table IV",
        "metrics of the best models that γ > 0 improves",
        "all",
        f"{a} of {n}",
        ours_text,
        verdict,
    )


def step_claims(epoch_steps: int = 3712) -> list[Claim]:
    """Table IV prints steps in thousands: they are whole epochs of the 3712 training frames."""
    found, seen = [], set()
    rows = [("Table IV", row) for row in published_table("IV").to_dict("records")]
    rows += [("Table IV, arXiv", row) for row in published_table("IV_arxiv").to_dict("records")]
    for where, row in rows:
        if (row["detector"], row["step"]) in seen:
            continue
        seen.add((row["detector"], row["step"]))
        printed = float(str(row["step"]).rstrip("k")) * 1000
        epochs = round(printed / epoch_steps)
        text = f"step of the best {row['detector']}, γ = {row['gamma']}"
        recomputed = f"{epochs} epochs = {epochs * epoch_steps:,}"
        near = abs(epochs * epoch_steps - printed) < 1000
        found.append(
            Claim(
                where,
                text,
                str(row["step"]),
                recomputed,
                "",
                "printed correctly" if near else "printed wrong",
            )
        )
    return found
