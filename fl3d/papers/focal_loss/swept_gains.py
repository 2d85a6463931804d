"""Gains of a sweep over gamma, in the cells of the paper's tables, as its claims take them."""

from __future__ import annotations

from collections.abc import Mapping

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import CELLS, Resampled, Samples, paired
from fl3d.evaluation.intervals import Sample
from fl3d.papers.focal_loss.gain_claims import Gains, GainsByAverage
from fl3d.papers.focal_loss.tables import gamma_of
from fl3d.reports.table import AP_COLUMNS
from fl3d.runs.finished import FinishedSweep

R40 = AVERAGES.index("R40")


def models_by_gamma(
    sweep: FinishedSweep, samples: Samples
) -> dict[str, dict[float, dict[int, Resampled]]]:
    """Last models by detector, gamma and seed."""
    found: dict[str, dict[float, dict[int, Resampled]]] = {}
    for trial in sweep.trials:
        own = found.setdefault(trial.detector, {}).setdefault(gamma_of(trial.plan), {})
        own[trial.seed] = samples[trial.group][trial.level][trial.seed]
    return found


def differences(
    one: Mapping[float, Mapping[int, Resampled]], other: Mapping[float, Mapping[int, Resampled]]
) -> dict[tuple[float, str], Sample]:
    """AP of one detector's last models less another's of the same gamma, in R40, by the seeds that both have."""
    return {
        (gamma, column): paired(by_seed, other[gamma], CELLS.index(_cell(column)), R40)[1]
        for gamma, by_seed in sorted(one.items())
        if set(by_seed) & set(other.get(gamma, {}))
        for column in AP_COLUMNS
    }


def gains_over_zero(gammas: Mapping[float, Mapping[int, Resampled]]) -> GainsByAverage:
    """Gains of some gammas over gamma = 0, by the seeds that both have, in the cells of the paper's tables.

    Args:
        gammas: a detector's last models, by gamma and seed.
    """
    base = gammas.get(0.0, {})
    places = {column: CELLS.index(_cell(column)) for column in AP_COLUMNS}
    found: dict[str, Gains] = {}
    for average, name in enumerate(AVERAGES):
        own: dict[tuple[float, str], Sample] = {}
        for gamma, by_seed in sorted(gammas.items()):
            if gamma > 0 and set(by_seed) & set(base):
                for column, place in places.items():
                    own[gamma, column] = paired(by_seed, base, place, average)[1]
        found[name] = own
    return found


def _cell(column: str) -> tuple[str, str]:
    metric, difficulty = column.split("_")
    return metric, difficulty
