"""APs of a sweep and their gains over the baseline, with intervals over frames and seeds."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from fl3d.core.errors import ConfigError
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.bootstrap import Interval, Paired, paired_bootstrap
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from fl3d.evaluation.recall import OVERLAPS, recall
from fl3d.runs.finished import FinishedSweep

AVERAGES = ("R11", "R40")
# Group, then level, then seed.
Comparisons = dict[str, dict[str, dict[int, Comparison]]]


def compare_sweep(sweep: FinishedSweep, rule: str = "last") -> Comparisons:
    """Stored detections of a sweep's trials held against the labels, by group, level and seed.

    Args:
        sweep: its run folders must be at hand.
        rule: which checkpoint stands for a trial: ``last`` or ``best``.

    Raises:
        StoreError: only its scores are here.
        DataError: detections or labels cannot be read.
    """
    steps = sweep.steps(rule)
    found: Comparisons = {}
    for group in sweep.groups:
        found[group] = {level: {} for level in sweep.levels}
    for trial in sweep.trials:
        comparison = sweep.comparison(trial, steps[trial.key])
        found[trial.group][trial.level][trial.seed] = comparison
    return {
        group: {level: by_seed for level, by_seed in levels.items() if by_seed}
        for group, levels in found.items()
    }


def gains(compared: Comparisons, baseline: str, n_resamples: int = 1000) -> pd.DataFrame:
    """AP and gain of every level, metric and difficulty, with 95 % intervals.

    Args:
        compared: see ``compare_sweep``. Groups without the baseline are left out, and so are seeds that it lacks.
        baseline: level that the others are held against.
        n_resamples: of the bootstrap.

    Returns:
        a row for each group, level, metric, difficulty and average (R11, R40).

    Raises:
        ConfigError: no group has the baseline.
    """
    rows = []
    for group, levels in compared.items():
        base = levels.get(baseline, {})
        for level, by_seed in levels.items():
            seeds = sorted(set(by_seed) & set(base))
            if seeds:
                front = {"group": group, "level": level, "seeds": len(seeds)}
                pair = ([by_seed[seed] for seed in seeds], [base[seed] for seed in seeds])
                rows += [front | row for row in _rows(*pair, n_resamples)]
    if not rows:
        raise ConfigError(
            f"a gain needs a trial of the baseline '{baseline}' that is done, with a seed of the others; "
            "choose another level with sweep.baseline"
        )
    return pd.DataFrame(rows)


def _rows(
    side: Sequence[Comparison], base: Sequence[Comparison], n_resamples: int
) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for metric in METRICS:
        for difficulty in DIFFICULTIES:
            paired = paired_bootstrap(
                [one.matches("Car", metric, difficulty) for one in side],
                [one.matches("Car", metric, difficulty) for one in base],
                n_resamples,
            )
            for place, average in enumerate(AVERAGES):
                row: dict[str, object] = {"metric": metric, "difficulty": difficulty}
                rows.append(row | {"average": average} | _columns(paired, place))
    return rows


def _columns(paired: Paired, place: int) -> dict[str, object]:
    gain = paired.gain[place]
    return {
        **_interval("ap", paired.ap[place]),
        **_interval("gain", gain),
        "significant": gain.excludes_zero,
        "one_r11_step": paired.one_step and AVERAGES[place] == "R11",
    }


def _interval(name: str, interval: Interval) -> dict[str, object]:
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


def recalls(compared: Comparisons) -> pd.DataFrame:
    """Recall of the final boxes at 3D overlaps 0.1 to 0.9, over all labelled cars; a row a trial."""
    rows = []
    for group, levels in compared.items():
        for level, by_seed in levels.items():
            for seed, comparison in sorted(by_seed.items()):
                shares = recall(comparison.gt, comparison.overlaps)
                columns = {
                    f"recall_{overlap:g}": share
                    for overlap, share in zip(OVERLAPS, shares, strict=True)
                }
                rows.append({"group": group, "level": level, "seed": seed, **columns})
    return pd.DataFrame(rows)


def without_baseline(compared: Comparisons, baseline: str) -> list[str]:
    """Groups that have no gain: no trial of the baseline in them is done."""
    return [group for group, levels in compared.items() if baseline not in levels]
