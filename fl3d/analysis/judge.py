"""Verdicts on a sweep that grows: what was resampled once is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fl3d.analysis.found import draw_trial, sweep_verdicts
from fl3d.analysis.samples import Measured
from fl3d.analysis.seed_cost import work_seconds
from fl3d.core.errors import CheckpointError, DataError, StoreError
from fl3d.evaluation.bootstrap import N_RESAMPLES
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial
from fl3d.runs.units import units_of


class Judge:
    """Judges a sweep again and again, as more of its trials are done.

    Args:
        say: told of a trial whose files cannot be read; it is left out.
        n_resamples: of the frames.
    """

    def __init__(self, say: Callable[[str], None], n_resamples: int = N_RESAMPLES) -> None:
        self._say = say
        self._n_resamples = n_resamples
        self._drawn: dict[str, Measured] = {}
        self._torn: set[str] = set()
        self._units: NDArray[np.int64] | None = None

    def verdicts(self, sweep: FinishedSweep) -> pd.DataFrame:
        """The verdicts of ``analysis.found.sweep_verdicts``; no rows where there is no gain.

        Args:
            sweep: its run folders must be at hand, its scores need not.
        """
        readable = tuple(trial for trial in sweep.trials if self._is_read(sweep, trial))
        if not readable:
            return pd.DataFrame()
        return sweep_verdicts(replace(sweep, trials=readable), self._n_resamples, self._drawn)

    def _is_read(self, sweep: FinishedSweep, trial: FinishedTrial) -> bool:
        """Whether a trial's detections and markers can be read, which is tried once."""
        if trial.key not in self._drawn and trial.key not in self._torn:
            try:
                self._drawn[trial.key] = self._draw(sweep, trial)
            except (CheckpointError, DataError, StoreError) as error:
                self._say(f"{trial.key}: left out of the verdicts: {error}")
                self._torn.add(trial.key)
        return trial.key in self._drawn

    def _draw(self, sweep: FinishedSweep, trial: FinishedTrial) -> Measured:
        sum(work_seconds(folder) for folder in trial.folders)  # its markers are read too
        if self._units is None:
            self._units = units_of(sweep).of_frames
        return draw_trial(sweep, trial, self._units, self._n_resamples)
