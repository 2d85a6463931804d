"""Our gains as the paper's claims take them: of a sweep's resampled APs, by detector and gamma."""

from pathlib import Path

import pytest

from fl3d.analysis.found import judge_sweep
from fl3d.papers.focal_loss.swept_gains import differences, gains_over_zero, models_by_gamma
from fl3d.reports.table import AP_COLUMNS
from tests.analysis.making import detected_sweep, without

POINTS = [
    ["detector=fcn3d", f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 1) for seed in (0, 1)
]


def test_gains_are_those_of_the_sweep_over_gamma_zero(simulated: Path, tmp_path: Path) -> None:
    """Gamma 0 is not the sweep's baseline here; seed 1 has no model of gamma 1."""
    sweep = detected_sweep(
        simulated, tmp_path, POINTS, lambda trial: 9.0 * (trial.level == "1"), "sweep.baseline=1"
    )
    some = without(sweep, lambda trial: trial.level == "1" and trial.seed == 1)
    judged = judge_sweep(some, n_resamples=50)
    models = models_by_gamma(some, judged.samples)["3D-FCN"]
    gains = gains_over_zero(models)
    assert set(gains) == {"R11", "R40"}
    assert set(gains["R40"]) == {(1.0, column) for column in AP_COLUMNS}
    found = judged.gains.set_index(["level", "metric", "difficulty", "average"])["gain"]
    for average, own in gains.items():
        for (_, column), gain in own.items():
            metric, difficulty = column.split("_")
            assert len(gain.values) == 1
            over_one = found["0", metric, difficulty, average]
            assert gain.values[0] == pytest.approx(-over_one)
    assert any(gain.values[0] < 0 for gain in gains["R40"].values())
    turned = {0.0: models[1.0], 1.0: models[0.0]}  # as if of another detector
    apart = differences(models, turned)
    for column in AP_COLUMNS:
        assert apart[1.0, column].values == pytest.approx(gains["R40"][1.0, column].values)
        assert apart[0.0, column].values == pytest.approx(-gains["R40"][1.0, column].values)
