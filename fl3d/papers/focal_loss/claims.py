"""The paper's claims beside our store: gains, best models, hard windows, posteriors, and what the networks are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fl3d.analysis.found import Judged
from fl3d.analysis.samples import AVERAGES, CELLS, Resampled, Samples, paired
from fl3d.evaluation.intervals import Sample
from fl3d.inference.windows import Windows, windows_of
from fl3d.papers.base import with_values
from fl3d.papers.focal_loss.best_model_claims import best_claim, step_claims
from fl3d.papers.focal_loss.best_models import (
    BEST_MODELS,
    BEST_OWN_MODELS,
    best_pairs,
    improvements,
)
from fl3d.papers.focal_loss.claim import Claim, claims_table
from fl3d.papers.focal_loss.concentration_claims import Carried, carried, concentration_claims
from fl3d.papers.focal_loss.figures import posteriors_of
from fl3d.papers.focal_loss.gain_claims import Gains, GainsByAverage, gain_claims
from fl3d.papers.focal_loss.network_claims import network_claims
from fl3d.papers.focal_loss.order_claim import order_claim
from fl3d.papers.focal_loss.posterior_claims import (
    Peak,
    half_claim,
    hardest_share,
    peak_claim,
    peak_of,
)
from fl3d.papers.focal_loss.tables import GAMMA, gamma_of, is_over_gamma
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.runs.finished import FinishedSweep

R40 = AVERAGES.index("R40")
NOTES = (
    "What ours are is said below each table; 3D-FCN and VoxelNet at full size where windows and layers count.",
    "Ours of a gain: the value and an interval that it lies in with all gains that its sentence ranges over (95 %, "
    "frames and seeds), by the seeds that γ = 0 shares. The paper prints R11; larger and smaller are said by R40, "
    "which has fewer recall steps.",
)


def claims_of(sweep: FinishedSweep, judged: Judged | None) -> Table | None:
    """All claims about gains, windows and networks, as a table; None for a sweep that is not over gamma.

    Args:
        sweep: over gamma; its run folders must be at hand.
        judged: what it has found; None: nothing is said of our gains.
    """
    if not is_over_gamma(sweep):
        return None
    models = {} if judged is None else models_by_gamma(sweep, judged.samples)
    gains = {detector: gains_over_zero(gammas) for detector, gammas in models.items()}
    claims = gain_claims(gains, sweep.plan.looks)
    order = differences(models.get("VoxelNet", {}), models.get("3D-FCN", {}))
    claims.append(order_claim(order, sweep.plan.looks))
    improved = [improvements(sweep, table) for table in (BEST_MODELS, BEST_OWN_MODELS)]
    claims += [best_claim(*improved), *step_claims()]
    claims += [_half_of_loss(sweep)]
    claims += concentration_claims(_carried(sweep, "3D-FCN"), _carried(sweep, "VoxelNet"))
    claims += [*_peaks(sweep), *network_claims(sweep)]
    return claims_table(claims, NOTES)


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


def _half_of_loss(sweep: FinishedSweep) -> Claim:
    """Of every seed of 3D-FCN's best focal model."""
    gamma, models = _best_focal(sweep, "3D-FCN")
    shares = [
        (hardest_share(one.positive, 0.0), hardest_share(one.positive, gamma)) for one in models
    ]
    return half_claim(gamma, shares)


def _carried(sweep: FinishedSweep, detector: str) -> list[Carried]:
    """Of every seed of a detector's best focal model."""
    return [carried(one.positive, one.negative) for one in _best_focal(sweep, detector)[1]]


def _best_focal(sweep: FinishedSweep, detector: str) -> tuple[float, Iterator[Windows]]:
    """Gamma of a detector's best focal model, and the windows of each of its seeds; none where there is none.

    It is the best of the last stage, which the focal loss trained.
    """
    pairs = best_pairs(sweep, BEST_OWN_MODELS)
    pairs = pairs[(pairs["detector"] == detector) & (pairs["gamma"] > 0)] if len(pairs) else pairs
    if pairs.empty:
        return 0.0, iter(())
    gamma = float(pairs.iloc[0]["gamma"])
    chosen = with_values(sweep, sweep.select(BEST_OWN_MODELS.rule), {"gamma": GAMMA})
    chosen = chosen[(chosen["detector"] == detector) & (chosen["gamma"].astype(float) == gamma)]
    return gamma, (
        windows_of(sweep, sweep.trial(str(key)).holder(int(step)), int(step))
        for key, step in zip(chosen["trial"], chosen["step"], strict=True)
    )


def _peaks(sweep: FinishedSweep) -> list[Claim]:
    """A claim for each detector, and for all that may be taken for its positives."""
    peaks: dict[str, dict[str, dict[float, dict[int, Peak]]]] = {}
    for trial, kind, posteriors in posteriors_of(sweep):
        of_kind = peaks.setdefault(trial.detector, {}).setdefault(kind, {})
        of_kind.setdefault(gamma_of(trial.plan), {})[trial.seed] = peak_of(posteriors)
    return [
        peak_claim(detector, kind, own)
        for detector, kinds in sorted(peaks.items())
        for kind, own in kinds.items()
    ]
