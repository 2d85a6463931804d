"""What one more seed costs: by the times that its stages' markers tell."""

from dataclasses import replace
from pathlib import Path

import pytest

from fl3d.analysis.seed_cost import seed_minutes
from fl3d.runs.checkpoints import read_marker, write_marker
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep, without


@pytest.fixture
def sweep(simulated: Path, tmp_path: Path) -> FinishedSweep:
    """The shared warm-up takes 6 minutes; on top 1 minute of gamma 0 and 3 of gamma 2, and the seed's number each."""
    points = [[f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 2) for seed in (0, 1, 5)]
    found = detected_sweep(simulated, tmp_path, points, lambda trial: 0.1, "detector=voxelnet")
    for trial in found.trials:
        shared, own = trial.folders
        write_times(shared.steps()[-1], shared, {"training": 300.0, "detection": 60.0})
        minutes = {"0": 1, "2": 3}[trial.level] + trial.seed
        parts = {"training": 60.0 * minutes - 20, "detection": 15.0, "scoring": 5.0}
        write_times(own.steps()[-1], own, {**parts, "waiting": 1000.0})
    return found


def write_times(step: int, folder: object, seconds: dict[str, float]) -> None:
    write_marker(folder, replace(read_marker(folder, step), seconds=seconds))  # type: ignore[arg-type]


def test_a_seed_costs_its_level_and_its_baseline_and_what_they_share_once(
    sweep: FinishedSweep,
) -> None:
    """Waiting is a part of training, and of three seeds the one in the middle stands: seed 1."""
    found = seed_minutes(sweep)
    assert found == {
        ("VoxelNet", "0"): pytest.approx(6 + 1 + 1),
        ("VoxelNet", "2"): pytest.approx(6 + (1 + 1) + (3 + 1)),
    }


def test_checkpoints_of_a_stage_add_up(sweep: FinishedSweep) -> None:
    own = sweep.trials[0].folder
    last = own.steps()[-1]
    earlier = replace(read_marker(own, last), step=last - 1, seconds={"training": 600.0})
    write_marker(own, earlier)
    alone = without(sweep, lambda trial: trial.seed > 0)
    assert seed_minutes(alone)["VoxelNet", "0"] == pytest.approx(6 + 1 + 10)


def test_a_level_whose_baseline_is_not_done_costs_its_own(sweep: FinishedSweep) -> None:
    alone = without(sweep, lambda trial: trial.level == "0" or trial.seed > 0)
    assert seed_minutes(alone) == {("VoxelNet", "2"): pytest.approx(6 + 3)}
