"""Write a sweep's results folder: scores, tables and figures."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fl3d.errors import StoreError
from fl3d.files import write_text
from fl3d.reports.figures import ap_over_gamma, ap_over_steps
from fl3d.reports.tables import Table, make_tables, to_csv, to_latex, to_markdown

FRONT = [
    "trial",
    "detector",
    "gamma",
    "alpha",
    "beta",
    "eta",
    "lr",
    "seed",
    "protocol",
    "first_own_step",
    "epoch",
    "step",
]
NAMED = {
    "tags.fl3d.trial": "trial",
    "tags.fl3d.protocol": "protocol",
    "tags.fl3d.first_own_step": "first_own_step",
    "tags.detector": "detector",
    "params.seed": "seed",
    "params.optimizer.lr": "lr",
    **{f"params.loss.{name}": name for name in ("gamma", "alpha", "beta", "eta")},
}


def tidy(raw: pd.DataFrame, trials: set[str] | None = None, protocol: str | None = None) -> pd.DataFrame:
    """Arrange what the store reads back: one row a trial and step, numbers as numbers, in a fixed order.

    Args:
        raw: see ``store.tracking.Store.read``; holds the columns of ``NAMED``.
        trials: which to keep; None: all.
        protocol: id of the scores to keep; None: all.
    """
    if raw.empty:
        return pd.DataFrame(columns=FRONT)
    named = raw.rename(columns=NAMED)
    if trials is not None:
        named = named[named["trial"].isin(trials)]
    if protocol is not None:
        named = named[named["protocol"] == protocol]
    aps = sorted(str(column) for column in named if str(column).startswith("ap_"))
    frame = named[[*FRONT, *aps]].dropna(subset=aps).copy()
    texts = {"trial", "detector", "protocol"}
    for column in FRONT:
        if column not in texts:
            frame[column] = pd.to_numeric(frame[column])
    for column in ("seed", "first_own_step", "epoch", "step"):
        frame[column] = frame[column].astype(int)
    return frame.sort_values(["detector", "gamma", "trial", "step"]).reset_index(drop=True)


def read_scores(path: Path) -> pd.DataFrame:
    """Read a results folder's ``scores.csv``.

    Raises:
        StoreError: there is none, or a column is missing.
    """
    if not path.exists():
        raise StoreError(f"{path}: no such file, and the store holds no scores; run the sweep first")
    frame = pd.read_csv(path)
    missing = [column for column in FRONT if column not in frame]
    if missing:
        raise StoreError(f"{path}: no column {', '.join(missing)}")
    return frame


def write_results(
    scores: pd.DataFrame, folder: Path, stages: str, notes: tuple[str, ...]
) -> tuple[list[Table], list[Path]]:
    """Write ``scores.csv``, ``tables/`` and ``figures/``.

    Args:
        scores: tidy.
        folder: ``results/<data>-<profile>``.
        stages: where ``best`` looks, see ``selection.select``.
        notes: put below each table.

    Returns:
        the tables and every file written.
    """
    written = [folder / "scores.csv"]
    write_text(written[0], scores.to_csv(index=False, lineterminator="\n"))
    tables = make_tables(scores, stages, notes)
    for table in tables:
        for ending, render in (("md", to_markdown), ("tex", to_latex), ("csv", to_csv)):
            path = folder / "tables" / f"table_{table.number}.{ending}"
            write_text(path, render(table))
            written.append(path)
    for stale in set((folder / "tables").glob("table_*")) - set(written):
        stale.unlink()  # of an earlier run with other trials: a folder shows one set of scores
    written += ap_over_steps(scores, folder / "figures" / "ap_over_steps")
    written += ap_over_gamma(scores, folder / "figures" / "ap_over_gamma")
    return tables, written
