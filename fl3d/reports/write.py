"""Write a sweep's results folder: scores, tables and figures."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fl3d.errors import StoreError
from fl3d.files import write_text
from fl3d.reports.figures.curves import ap_over_gamma, ap_over_steps
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.table import Table
from fl3d.reports.tables import LAST_TABLES, make_tables

JOINT = ("R6", "R7")  # tables of several sweeps
FRONT = [
    "trial",
    "detector",
    "gamma",
    "alpha",
    "beta",
    "eta",
    "normalize",
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
    "tags.fl3d.overrides": "overrides",
    "tags.detector": "detector",
    "params.seed": "seed",
    "params.optimizer.lr": "lr",
    **{f"params.loss.{name}": name for name in ("gamma", "alpha", "beta", "eta", "normalize")},
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
    others = sorted(str(column) for column in named if str(column).startswith("recall_"))
    frame = named[[*FRONT, "overrides", *aps, *others]].dropna(subset=aps).copy()
    frame["overrides"] = frame["overrides"].astype(object).fillna("")  # of runs from before they were told
    texts = {"trial", "detector", "protocol", "normalize"}
    frame["normalize"] = frame["normalize"].astype(str).str.lower() == "true"
    for column in FRONT:
        if column not in texts:
            frame[column] = pd.to_numeric(frame[column])
    for column in ("seed", "first_own_step", "epoch", "step"):
        frame[column] = frame[column].astype(int)
    return frame.sort_values(["detector", "gamma", "trial", "step"]).reset_index(drop=True)


def read_scores(path: Path) -> pd.DataFrame:
    """Read the scores of a results folder.

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


def scores_path(folder: Path, sweep: str) -> Path:
    """Where a results folder keeps the scores of one sweep: all that its tables and curves are made from."""
    return folder / "scores" / f"{sweep}.csv"


def write_results(
    scores: pd.DataFrame, folder: Path, sweep: str, numbers: tuple[str, ...], stages: str, notes: tuple[str, ...]
) -> tuple[list[Table], list[Path]]:
    """Write a sweep's scores, tables and curves.

    Args:
        scores: tidy.
        folder: ``results/<data>-<profile>``.
        sweep: its name.
        numbers: of the tables it feeds.
        stages: where ``best`` looks, see ``selection.select``.
        notes: put below each table.

    Returns:
        the tables and every file written.
    """
    written = [scores_path(folder, sweep)]
    text = scores.to_csv(index=False, lineterminator="\n")
    is_new = not written[0].exists() or written[0].read_text() != text
    write_text(written[0], text)
    alone = tuple(number for number in numbers if number not in JOINT)
    tables = make_tables(scores, alone, stages, notes) if alone else []
    joint = tuple(number for number in numbers if number in JOINT)
    tables += make_tables(_all_scores(folder, scores), joint, stages, notes) if joint else []
    written += write_tables(tables, folder)
    for number in numbers if is_new else ():
        for stale in set((folder / "tables").glob(f"table_{number}[._]*")) - set(written):
            stale.unlink()  # of other trials or scores: a folder shows one set, and views are made again from it
    if {table.number for table in tables} & set(LAST_TABLES):
        written += ap_over_steps(scores, folder / "figures" / "ap_over_steps", stages)
        if is_new or not (folder / "figures" / "ap_over_gamma.png").exists():
            ap_over_gamma(scores, folder / "figures" / "ap_over_gamma")  # with intervals once tables are made again
        written += [folder / "figures" / f"ap_over_gamma.{ending}" for ending in ("csv", "png", "pdf")]
    return tables, written


def _all_scores(folder: Path, scores: pd.DataFrame) -> pd.DataFrame:
    """Scores of all sweeps of a results folder under the protocol of these."""
    protocols = set(scores["protocol"])
    every = [read_scores(path) for path in sorted((folder / "scores").glob("*.csv"))]
    return pd.concat([one[one["protocol"].isin(protocols)] for one in every], ignore_index=True)


def write_tables(tables: list[Table], folder: Path) -> list[Path]:
    """Each table as Markdown, LaTeX and CSV; every file written."""
    written = []
    for table in tables:
        for ending, render in (("md", to_markdown), ("tex", to_latex), ("csv", to_csv)):
            path = folder / "tables" / f"table_{table.name}.{ending}"
            write_text(path, render(table))
            written.append(path)
    return written
