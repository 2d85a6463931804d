"""A verdict on every level of a sweep, by its primary metric."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import CELLS, Samples, interval_columns, paired
from fl3d.config.settings import SweepSettings
from fl3d.evaluation.intervals import (
    ALPHA,
    Interval,
    Sample,
    frames_alpha,
    frames_reach,
    interval,
    joint_intervals,
    member_alpha,
)
from fl3d.evaluation.verdicts import MOST, Known, Verdict, is_hopeless, seeds_needed, verdict_of

Pairs = Mapping[str, tuple[Sample, Sample]]  # AP and gain by level
Planned = Mapping[str, int]  # numbers of levels by group


def verdicts(
    samples: Samples,
    baseline: str,
    asked: SweepSettings,
    looks: tuple[int, ...] = (),
    planned: Planned | None = None,
) -> pd.DataFrame:
    """A verdict on every level, by the primary metric, see ``judge``.

    Args:
        samples: of last checkpoints.
        baseline: level that the others are held against.
        asked: primary metric and margin.
        looks: see ``judge``.
        planned: likewise.
    """
    cell, average = primary_place(asked)
    pairs: dict[str, Pairs] = {}
    for group, levels in samples.items():
        base = levels.get(baseline, {})
        own = {level: by_seed for level, by_seed in levels.items() if set(by_seed) & set(base)}
        pairs[group] = {
            level: paired(by_seed, base, cell, average) for level, by_seed in own.items()
        }
    return judge(pairs, baseline, asked, looks, planned)


def judge(
    pairs: Mapping[str, Pairs],
    baseline: str,
    asked: SweepSettings,
    looks: tuple[int, ...] = (),
    planned: Planned | None = None,
) -> pd.DataFrame:
    """A verdict on every level.

    Args:
        pairs: AP and gain of each level in the primary metric, by group.
        baseline: level that the others are held against.
        asked: primary metric and margin.
        looks: numbers of seeds after which verdicts were asked for, see ``evaluation.intervals.member_alpha``.
        planned: how many levels each group is to have beside the baseline: those that are not there yet keep their
            share of the error, for they are looked at later; None: no more than there are.

    Returns:
        a row for each group with the baseline and each of its levels: ``seeds``, ``ap`` and ``gain`` with ``_low`` and
        ``_high`` (the gain's hold for all levels of the group at once), ``spread`` of the gain between seeds,
        ``verdict``, ``more_seeds`` that would probably decide (NaN: none needed, or not to be had by seeds),
        ``open``: whether there is no verdict and more seeds may bring one, and ``copies``: seeds that have the same
        detections, in words, which leave their level without a verdict; they are counted once.
    """
    rows = []
    for group, levels in pairs.items():
        error = _error(sum(level != baseline for level in levels), (planned or {}).get(group, 0))
        for level, row in judge_group(levels, baseline, asked.margin, looks, error).items():
            rows.append({"group": group, "level": level, "metric": asked.primary, **row})
    return pd.DataFrame(rows)


def _error(n_levels: int, n_planned: int) -> float:
    """Error of a group's levels together, of which others are to come (Šidák)."""
    return ALPHA if n_planned <= n_levels else 1 - (1 - ALPHA) ** (n_levels / n_planned)


def primary_place(asked: SweepSettings) -> tuple[int, int]:
    """Places of the primary metric in ``CELLS`` and ``AVERAGES``."""
    metric, difficulty = asked.metric.split("/")
    return CELLS.index((metric, difficulty)), AVERAGES.index(asked.average)


def judge_group(
    pairs: Pairs,
    baseline: str,
    margin: float,
    looks: tuple[int, ...] = (),
    error: float = ALPHA,
) -> dict[str, dict[str, object]]:
    """Rows of the levels of one group, see ``judge``, by level; ``error``: that any of their gains misses."""
    family = {level: gain for level, (_, gain) in pairs.items() if level != baseline}
    found = dict(zip(family, joint_intervals(list(family.values()), error, looks), strict=True))
    rows: dict[str, dict[str, object]] = {}
    for level, (ap, gain) in pairs.items():
        row: dict[str, object] = {
            "seeds": len(gain.values),
            **interval_columns("ap", interval(ap).within_percent()),
            "copies": _copies_text(ap, gain),
        }
        if level == baseline:
            zero = Interval(0.0, 0.0, 0.0)
            row |= {
                **interval_columns("gain", zero),
                "spread": float("nan"),
                "verdict": Verdict.BASELINE,
            }
            rows[level] = row | {"more_seeds": float("nan"), "open": False}
            continue
        one = found[level]
        is_empty = not ap.values.any() and not gain.values.any()
        has_none = is_empty or bool(gain.copies) or bool(np.isnan(one.value))
        word = Verdict.NONE if has_none else verdict_of(one, len(gain.values), margin)
        row |= {**interval_columns("gain", one), "spread": gain.spread, "verdict": word}
        rows[level] = row | _outlook(gain, family, margin, word, looks, error)
    return rows


def _copies_text(ap: Sample, gain: Sample) -> str:
    """Seeds that are no runs of their own: ``seeds 0, 1, 2``, ``the baseline's seeds 0, 1``; or nothing."""
    whose = "" if ap.copies else "the baseline's "
    return f"{whose}seeds {', '.join(map(str, gain.copies))}" if gain.copies else ""


def _outlook(
    gain: Sample,
    family: Mapping[str, Sample],
    margin: float,
    word: Verdict,
    looks: tuple[int, ...],
    error: float,
) -> dict[str, object]:
    """How many more seeds would probably decide, and whether they may: ``more_seeds`` and ``open``."""
    n_seeds = len(gain.values)
    if np.isnan(gain.values).any():  # no ground truth counts
        return {"more_seeds": float("nan"), "open": False}
    if gain.copies:  # further seeds of what does not read its seed are copies too
        return {"more_seeds": float("nan"), "open": False}
    if word.is_final or n_seeds < 2:
        return {"more_seeds": float("nan"), "open": not word.is_final}
    draws = np.stack([one.draws for one in family.values()], axis=1)
    value = float(gain.values.mean())
    alone = Sample(gain.values.mean(keepdims=True), gain.draws)
    frames = interval(alone, error, frames_alpha(draws, error), frames_reach(draws, error))
    known = Known(
        gain=value,
        spread=gain.spread,
        below=value - frames.low,
        above=frames.high - value,
        n_seeds=n_seeds,
        lasting=gain.lasting,
    )
    most = looks[-1] if looks else MOST
    alpha = member_alpha(len(family), most, looks, error)
    needed = seeds_needed(known, margin, alpha, n_seeds + 1)
    more = float("nan") if needed is None else float(needed - n_seeds)
    return {"more_seeds": more, "open": not is_hopeless(known, margin, most)}
