"""The paper's sentence that networks of the focal loss are as good once the cut of scores is lowered (§VI-C). Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fl3d.evaluation.intervals import interval
from fl3d.papers.claim import (
    SEEDS_ALONE,
    Claim,
    interval_text,
    over_seeds,
    seeds_in,
    too_few,
    word_of,
)

WHERE = "§VI-C"
PRINTED = "also accurate at a lower threshold"
NO_CUT = 0.0
PAPERS_CUT = 0.8  # §VI-A
AtCuts = tuple[float, float]  # 3D AP moderate (R11) of one model without a cut, and at the paper's


def cut_claim(detector: str, aps: Mapping[float, Mapping[int, AtCuts]]) -> Claim:
    """Of what the largest gamma loses against gamma = 0 at the paper's cut, how much it does not lose without a cut.

    Args:
        detector: whose.
        aps: of its last models, by gamma and seed.
    """
    text = f"what {detector} loses by the largest γ at a cut of {PAPERS_CUT:g}, and not without one (R11)"
    largest = max(aps, default=0.0)
    seeds = sorted(set(aps.get(0.0, {})) & set(aps[largest])) if largest > 0 else []
    if not seeds:
        return Claim(WHERE, text, PRINTED, "", "", "")
    gains = np.array([np.subtract(aps[largest][seed], aps[0.0][seed]) for seed in seeds])
    without, at_cut = gains.mean(axis=0)
    ours = f"γ = {largest:g} gains {at_cut:+.2f} AP at the cut, {without:+.2f} without"
    few = too_few(len(seeds))
    if few:
        return Claim(WHERE, text, PRINTED, "", f"{ours}; {seeds_in(len(seeds))}", f"ours: {few}")
    regained = interval(over_seeds(gains[:, 0] - gains[:, 1]))
    ours += f": {interval_text(regained)} {SEEDS_ALONE}; {seeds_in(len(seeds))}"
    return Claim(WHERE, text, PRINTED, "", ours, f"ours: {word_of(regained)}")
