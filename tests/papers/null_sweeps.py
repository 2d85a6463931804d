"""Sweeps under no effect: resampled APs of models whose true AP is the same for every gamma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import CELLS, Resampled
from fl3d.papers.focal_loss.gain_claims import GainsByAverage
from fl3d.papers.focal_loss.swept_gains import gains_over_zero

GAMMAS = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
SHARED = 0.7  # of a model's variance, that its cells have in common
TRUE_AP = 60.0


@dataclass(frozen=True)
class NoEffect:
    """How far APs move by chance.

    Args:
        n_seeds: of every gamma.
        of_training: s.d. of a model's AP between seeds.
        of_frames: s.d. of a model's AP between sets of frames, beside what all models have in common.
        alike: share of that variance that the seeds of a gamma have in common. Where gammas differ in nothing, none;
            gammas of equal true AP may yet find other cars.
        n_resamples: of the frames.
    """

    n_seeds: int
    of_training: float
    of_frames: float
    alike: float = 0.0
    n_resamples: int = 400

    def models(self, rng: np.random.Generator) -> dict[float, dict[int, Resampled]]:
        """Models of one sweep, by gamma and seed."""
        found: dict[float, dict[int, Resampled]] = {}
        for gamma in GAMMAS:
            alike = np.sqrt(self.alike) * self._frames(rng)
            found[gamma] = {}
            for seed in range(self.n_seeds):
                moved = alike + np.sqrt(1 - self.alike) * self._frames(rng)
                value = TRUE_AP + self.of_training * _noise(rng, 1)[0] + moved[0]
                found[gamma][seed] = Resampled(value, value + moved[1:])
        return found

    def _frames(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """How far an AP moves on these frames, and in each resample of them."""
        return self.of_frames * _noise(rng, 1 + self.n_resamples)

    def gains(self, rng: np.random.Generator) -> dict[str, GainsByAverage]:
        """Gains of one sweep, of both detectors of the paper."""
        return {name: gains_over_zero(self.models(rng)) for name in ("3D-FCN", "VoxelNet")}


def _noise(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """(n, 9, 2) of unit variance, which the cells of a model have partly in common."""
    own = rng.standard_normal((n, len(CELLS), len(AVERAGES)))
    common = rng.standard_normal((n, 1, 1))
    return np.sqrt(1 - SHARED) * own + np.sqrt(SHARED) * common
