"""The scores of a sweep as one tidy frame, and the files that keep them with a results folder.

A row is a trial at a step: ``trial``, ``group``, ``level``, ``seed``, ``detector``, ``protocol``, ``first_own_step``,
``epoch``, ``step``, then every AP and every recall. Beside the CSV lies the sweep's frozen plan, which says what each
trial is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from fl3d.core.errors import StoreError
from fl3d.core.files import write_text
from fl3d.evaluation.protocol import Protocol, split_metric
from fl3d.runs.design import in_order
from fl3d.runs.plans import FrozenPlan, FrozenTrial, read_plan, write_plan

FRONT = [
    "trial",
    "detector",
    "group",
    "level",
    "seed",
    "protocol",
    "first_own_step",
    "epoch",
    "step",
]


def tidy(raw: pd.DataFrame, trials: Sequence[FrozenTrial], protocol: Protocol) -> pd.DataFrame:
    """Arrange what a store reads back.

    Checkpoints that lack an AP that others have are left out; without its last one a trial is, see ``lacking``.

    Args:
        raw: see ``store.base.Store.read``.
        trials: those to keep.
        protocol: of the scores to keep.
    """
    if raw.empty or not trials:
        return pd.DataFrame(columns=FRONT)
    merged, aps = _with_aps(raw, trials, protocol)
    recalls = sorted(str(column) for column in merged if str(column).startswith("recall_"))
    without = list(lacking(raw, trials, protocol))
    merged = merged[~merged["trial"].isin(without)]
    frame = merged[[*FRONT, *aps, *recalls]].dropna(subset=aps)
    frame = frame.astype({"seed": int, "first_own_step": int, "epoch": int, "step": int})
    place = {level: number for number, level in enumerate(in_order(t.level for t in trials))}
    return (
        frame.assign(_place=frame["level"].map(place))
        .sort_values(["group", "_place", "seed", "trial", "step"])
        .drop(columns="_place")
        .reset_index(drop=True)
    )


def lacking(
    raw: pd.DataFrame, trials: Sequence[FrozenTrial], protocol: Protocol
) -> dict[str, tuple[str, ...]]:
    """APs that others have and that the last checkpoint of a trial lacks, by the trial's key; arguments as ``tidy``."""
    if raw.empty or not trials:
        return {}
    merged, aps = _with_aps(raw, trials, protocol)
    last = merged.sort_values("step").groupby("trial").tail(1).set_index("trial")[aps].isna()
    short = last[last.any(axis=1)]
    return {str(key): tuple(row.index[row]) for key, row in short.iterrows()}


def _with_aps(
    raw: pd.DataFrame, trials: Sequence[FrozenTrial], protocol: Protocol
) -> tuple[pd.DataFrame, list[str]]:
    """Rows of some trials that have any AP, with what the trials are; and the APs that any row has."""
    own = raw[raw["protocol"] == protocol.id]
    plans = pd.DataFrame(
        {
            "trial": [trial.key for trial in trials],
            "detector": [trial.detector for trial in trials],
            "group": [trial.group for trial in trials],
            "level": [trial.level for trial in trials],
            "seed": [trial.seed for trial in trials],
            "first_own_step": [trial.first_own_step for trial in trials],
        }
    )
    merged = own.merge(plans, on="trial")
    # A store may hold metrics of other protocols, which this one does not have.
    aps = sorted(
        str(column)
        for column in merged
        if str(column).startswith("ap_") and merged[column].notna().any()
    )
    return merged.dropna(subset=aps, how="all"), aps


def scores_of_class(scores: pd.DataFrame, name: str) -> pd.DataFrame:
    """Scores of one of several classes, named as if it were the only one."""
    metrics = [str(c) for c in scores if str(c).startswith(("ap_", "recall_"))]
    own = {c: split_metric(c)[0] for c in metrics if split_metric(c)[1] == name}
    return scores.drop(columns=[c for c in metrics if c not in own]).rename(columns=own)


def score_file(folder: Path, sweep: str) -> Path:
    """Where a results folder keeps the scores of one sweep."""
    return folder / "scores" / f"{sweep}.csv"


def score_text(scores: pd.DataFrame) -> str:
    """What the file of a sweep's scores holds."""
    return scores.to_csv(index=False, lineterminator="\n")


def write_score_file(path: Path, scores: pd.DataFrame, plan: FrozenPlan) -> list[Path]:
    """Write a sweep's scores, and its plan beside them; both files, the scores last.

    The words that started it stay in the store: they hold this machine's paths, and equal sweeps have equal files.
    """
    write_plan(path.with_suffix(".json"), replace(plan, words=()))
    write_text(path, score_text(scores))
    return [path, path.with_suffix(".json")]


def read_score_file(path: Path, protocol: Protocol) -> tuple[FrozenPlan, pd.DataFrame]:
    """Read what ``write_score_file`` wrote.

    Raises:
        StoreError: a file or a column is missing, or there are no scores under the protocol.
    """
    scores = pd.read_csv(
        path, dtype={"level": str, "group": str}, keep_default_na=False, na_values=[""]
    )
    missing = [column for column in FRONT if column not in scores]
    if missing:
        raise StoreError(f"{path}: no column {', '.join(missing)}")
    own = scores[scores["protocol"] == protocol.id]
    if own.empty:
        there = ", ".join(sorted(scores["protocol"].unique()))
        raise StoreError(
            f"{path}: no scores under protocol {protocol.id}, only {there}; run the sweep with it first"
        )
    return read_plan(path.with_suffix(".json")), own.reset_index(drop=True)
