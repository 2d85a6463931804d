"""What trainings recorded beside their scores, as the paper's claims take it: terms of the loss, and its course."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fl3d.papers.focal_loss.loss_term_claims import Terms
from fl3d.papers.focal_loss.scratch_claims import Course
from fl3d.papers.focal_loss.tables import GAMMA, LAST_TABLES, gamma_of
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial

TERMS = ("cls_pos", "cls_neg", "reg")
WHOLE = "total"
AP = "ap_3d/moderate"


def losses_of(trial: FinishedTrial) -> dict[int, Mapping[str, float]]:
    """Means of the loss's terms since the checkpoint before, by step; its stages one behind the other."""
    return {
        step: read_marker(folder, step).losses
        for folder in trial.folders
        for step in folder.steps()
    }


def terms_of(trials: Iterable[FinishedTrial]) -> list[Terms]:
    """Terms of each training that recorded them; a term of zero has no magnitude, its checkpoint is left out."""
    found = []
    for trial in trials:
        rows = [[one.get(name, 0.0) for name in TERMS] for one in losses_of(trial).values()]
        own = np.array([row for row in rows if min(row) > 0])
        if len(own):
            found.append(Terms(*own.T))
    return found


def is_from_scratch(sweep: FinishedSweep) -> bool:
    """Whether a sweep compares gammas of the paper's detectors, each trained in one stage."""
    own = [trial.plan for trial in sweep.trials]
    return sweep.factor == (GAMMA,) and all(
        one.detector in LAST_TABLES and not one.first_own_step for one in own
    )


def courses_of(sweep: FinishedSweep, detector: str) -> dict[float, dict[int, Course]]:
    """How the trainings of a detector went, by gamma and seed; of those with two checkpoints that recorded losses."""
    found: dict[float, dict[int, Course]] = {}
    for trial in sweep.trials:
        losses = {step: own[WHOLE] for step, own in losses_of(trial).items() if WHOLE in own}
        scores = sweep.scores[sweep.scores["trial"] == trial.key].sort_values("step")
        own = scores[scores["step"].isin(losses)]
        if trial.detector == detector and len(own) > 1:
            course = Course(own[AP].to_numpy(), np.array([losses[step] for step in own["step"]]))
            found.setdefault(gamma_of(trial.plan), {})[trial.seed] = course
    return found
