"""The paper's claims beside our store: gains, best models, windows, posteriors, networks, and how they were trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from fl3d.analysis.contributions import CUTS, Contributions
from fl3d.inference.kept_windows import Place, made_of, positives_of, windows_of
from fl3d.papers.base import with_values
from fl3d.papers.claim import Claim, claims_table
from fl3d.papers.focal_loss.best_model_claims import best_claim, step_claims
from fl3d.papers.focal_loss.best_models import (
    BEST_MODELS,
    BEST_OWN_MODELS,
    best_pairs,
    improvements,
)
from fl3d.papers.focal_loss.concentration_claims import Carried, carried, concentration_claims
from fl3d.papers.focal_loss.cut_claim import NO_CUT, PAPERS_CUT, AtCuts, cut_claim
from fl3d.papers.focal_loss.figures import posteriors_of, windows_by_height
from fl3d.papers.focal_loss.gain_claims import gain_claims
from fl3d.papers.focal_loss.height_claim import height_claim
from fl3d.papers.focal_loss.loss_term_claims import loss_term_claims
from fl3d.papers.focal_loss.network_claims import network_claims
from fl3d.papers.focal_loss.order_claim import order_claim
from fl3d.papers.focal_loss.posterior_claims import (
    Peak,
    half_claim,
    hardest_share,
    peak_claim,
    peak_of,
)
from fl3d.papers.focal_loss.recorded import courses_of, is_from_scratch, terms_of
from fl3d.papers.focal_loss.scratch_claims import scratch_claim
from fl3d.papers.focal_loss.swept_gains import differences, gains_over_zero, models_by_gamma
from fl3d.papers.focal_loss.tables import (
    GAMMA,
    LAST_TABLES,
    LOSS_FORMS,
    NORMALIZE,
    gamma_of,
    is_over_gamma,
)
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, kept
from fl3d.runs.layout import RunFolder

NOTES = (
    "What ours are is said below each table; 3D-FCN and VoxelNet at full size where windows and layers count.",
    "Ours of a gain: the value and an interval that it lies in with all gains that its sentence ranges over (95 %, "
    "frames and seeds), by the seeds that γ = 0 shares. The paper prints R11; larger and smaller are said by R40, "
    "which has fewer recall steps.",
    "Behind an interval 'over seeds' there are seeds of training alone: frames were not resampled, and are the same "
    "for all of these seeds, so it says nothing of other frames.",
    "Terms of the loss: ratios of means between checkpoints under γ = 0, over all of training, each checkpoint alike.",
)


def claims_of(sources: Sequence[Contributions]) -> Table | None:
    """All claims, as a table; None where no sweep is over gamma.

    Args:
        sources: sweeps whose run folders are at hand; the first that is over gamma counts, the first whose gammas are
            trained from scratch, and the first with the original form of the loss.
    """
    over_gamma = next((one for one in sources if is_over_gamma(one.sweep)), None)
    scratch = next((one.sweep for one in sources if is_from_scratch(one.sweep)), None)
    if over_gamma is None and scratch is None:
        return None
    claims = [] if over_gamma is None else _of_gamma(over_gamma)
    forms = next((one.sweep for one in sources if LOSS_FORMS.name in _tables(one.sweep)), None)
    claims += _loss_terms(None if over_gamma is None else over_gamma.sweep, forms)
    for detector in LAST_TABLES:
        courses = {} if scratch is None else courses_of(scratch, detector)
        claims.append(scratch_claim(detector, courses))
    return claims_table(claims, NOTES)


def _of_gamma(source: Contributions) -> list[Claim]:
    """What a sweep over gamma says, and what the networks are."""
    sweep = source.sweep
    models = models_by_gamma(sweep, source.samples())
    gains = {detector: gains_over_zero(gammas) for detector, gammas in models.items()}
    claims = gain_claims(gains, sweep.plan.looks)
    order = differences(models.get("VoxelNet", {}), models.get("3D-FCN", {}))
    claims.append(order_claim(order, sweep.plan.looks))
    improved = [improvements(sweep, table) for table in (BEST_MODELS, BEST_OWN_MODELS)]
    claims += [best_claim(*improved), *step_claims()]
    claims += [_half_of_loss(sweep)]
    claims += concentration_claims(_carried(sweep, "3D-FCN"), _carried(sweep, "VoxelNet"))
    claims += [*_peaks(sweep), *_cuts(source)]
    return [*claims, height_claim(windows_by_height(sweep)), *network_claims(sweep)]


def _tables(sweep: FinishedSweep) -> Sequence[str]:
    return sweep.settings.sweep.tables


def _loss_terms(over_gamma: FinishedSweep | None, forms: FinishedSweep | None) -> list[Claim]:
    """Of trainings under gamma = 0: what enters the loss is then what the paper weighs."""
    trials = () if over_gamma is None else over_gamma.trials
    plain = {
        detector: [t for t in trials if t.detector == detector and gamma_of(t.plan) == 0]
        for detector in LAST_TABLES
    }
    sums = () if forms is None else forms.trials
    original = [
        t for t in sums if t.detector == LOSS_FORMS.detector and t.plan.value(NORMALIZE) is False
    ]
    return loss_term_claims(
        terms_of(plain["3D-FCN"]), terms_of(plain["VoxelNet"]), terms_of(original)
    )


def _half_of_loss(sweep: FinishedSweep) -> Claim:
    """Of every seed of 3D-FCN's best focal model."""
    gamma, models = _best_focal(sweep, "3D-FCN")
    every = [positives_of(sweep, *one) for one in models]
    shares = [(hardest_share(one, 0.0), hardest_share(one, gamma)) for one in every]
    return half_claim(gamma, shares)


def _carried(sweep: FinishedSweep, detector: str) -> list[Carried]:
    """Of every seed of a detector's best focal model."""
    return [_carried_by(sweep, *one) for one in _best_focal(sweep, detector)[1]]


def _carried_by(sweep: FinishedSweep, folder: RunFolder, step: int) -> Carried:
    """Of one checkpoint; kept, for its windows are many."""

    def make() -> Arrays:
        windows = windows_of(sweep, folder, step)
        values = asdict(carried(windows.positive, windows.negative))
        return {name: np.array(value) for name, value in values.items()}

    whole = {**made_of(sweep, folder, step), "by": code_digest("papers/focal_loss")}
    found = kept(folder.kept(step, "carried"), whole, make)
    return Carried(
        hardest=_pair(found["hardest"]),
        few=float(found["few"]),
        apart=float(found["apart"]),
        moved=_pair(found["moved"]),
        parted=float(found["parted"]),
    )


def _pair(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _best_focal(sweep: FinishedSweep, detector: str) -> tuple[float, list[Place]]:
    """Gamma of a detector's best focal model, and the checkpoint of each of its seeds; none where there is none.

    It is the best of the last stage, which the focal loss trained.
    """
    pairs = best_pairs(sweep, BEST_OWN_MODELS)
    pairs = pairs[(pairs["detector"] == detector) & (pairs["gamma"] > 0)] if len(pairs) else pairs
    if pairs.empty:
        return 0.0, []
    gamma = float(pairs.iloc[0]["gamma"])
    chosen = with_values(sweep, sweep.select(BEST_OWN_MODELS.rule), {"gamma": GAMMA})
    chosen = chosen[(chosen["detector"] == detector) & (chosen["gamma"].astype(float) == gamma)]
    return gamma, [
        (sweep.trial(str(key)).holder(int(step)), int(step))
        for key, step in zip(chosen["trial"], chosen["step"], strict=True)
    ]


def _cuts(source: Contributions) -> list[Claim]:
    """A claim for each detector: what the largest gamma loses by a cut of scores."""
    found: dict[str, dict[float, dict[int, AtCuts]]] = {}
    for trial in source.sweep.trials:
        by_gamma = found.setdefault(trial.detector, {})
        aps = dict(zip(CUTS, source.at_cuts(trial), strict=True))
        at_both = (float(aps[NO_CUT]), float(aps[PAPERS_CUT]))
        by_gamma.setdefault(gamma_of(trial.plan), {})[trial.seed] = at_both
    return [cut_claim(detector, aps) for detector, aps in sorted(found.items())]


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
