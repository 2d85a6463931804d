"""Of how many seeds of training the cells of a table are means, and how rows of unlike seeds are compared. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import pandas as pd

from fl3d.reports.table import is_better

PAIRED = "Bold is by the seeds that a row has in common with the one that it is held against."
UNPAIRED = "Bold compares means of unlike seeds."


def seeds_note(seeds: Mapping[str, Collection[int]], bold: str = "") -> str:
    """Of how many seeds of training the rows of a table are means, and which rows lack some that others have.

    Args:
        seeds: of each row, by what tells it.
        bold: what bold then stands for, where rows lack some; empty: nothing is bold.
    """
    counts = sorted({len(set(own)) for own in seeds.values()})
    every = sorted({seed for own in seeds.values() for seed in own})
    lacking = {name: sorted(set(own)) for name, own in seeds.items() if set(own) != set(every)}
    if counts[-1] == 1:
        told = "One seed of training"
    elif len(counts) == 1:
        told = f"Mean of {counts[0]} seeds of training"
    else:
        told = f"Mean of {counts[0]} to {counts[-1]} seeds of training"
    if not lacking:
        return f"{told}."
    rows = ", ".join(f"{name} ({_listed(own)})" for name, own in lacking.items())
    note = f"{told}, of each row its own; rows without all of seeds {_listed(every)}: {rows}."
    return f"{note} {bold}" if bold else note


def gains_note(seeds: Mapping[str, int], of_baseline: int) -> tuple[str, ...]:
    """Where a column of APs and one of gains are of unlike seeds: which rows' gains are no difference of two APs.

    Args:
        seeds: of each row, how many it shares with the baseline, by what tells it.
        of_baseline: how many seeds the baseline's own AP is of.

    Returns:
        one sentence; none where all rows have all the baseline's seeds.
    """
    fewer = [
        f"{name} ({count} of {of_baseline})" for name, count in seeds.items() if count < of_baseline
    ]
    if not fewer:
        return ()
    return (
        "AP and gain of a level are of the seeds that it shares with the baseline, whose own AP is of all its seeds: "
        f"the gain is not the difference of the two APs for {', '.join(fewer)}.",
    )


def _listed(seeds: Collection[int]) -> str:
    return ", ".join(str(seed) for seed in seeds)


def seeds_by(frame: pd.DataFrame, columns: list[str]) -> dict[str, list[int]]:
    """Seeds of a frame's rows by the text of some of its columns, as ``seeds_note`` takes them."""
    grouped = frame.groupby(columns, sort=False)["seed"]
    return {
        " ".join(str(value) for value in key) if isinstance(key, tuple) else str(key): list(own)
        for key, own in grouped
    }


def better_in_pairs(own: pd.DataFrame, base: pd.DataFrame, metrics: Collection[str]) -> list[bool]:
    """Whether a row is better than another, of each metric, by the seeds that both have; without such: not.

    With the same seeds on both sides, this is the bold rule of the printed means.

    Args:
        own: a row for each ``seed``.
        base: likewise.
        metrics: columns.
    """
    shared = set(own["seed"]) & set(base["seed"])
    if not shared:
        return [False] * len(metrics)
    here, there = (side[side["seed"].isin(shared)] for side in (own, base))
    return [is_better(float(here[m].mean()), float(there[m].mean())) for m in metrics]
