"""What is left of a small sweep's weights."""

from pathlib import Path

import pytest

from fl3d.evaluation.selection import MEAN_3D
from fl3d.runs.checkpoints import last_state
from fl3d.runs.spec import read_scores
from fl3d.sweep.setup import Prepared
from tests.support import run_small, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]


@pytest.fixture(scope="module")
def finished(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    words = ("schedule.stages.warmup.epochs=3", "store.keep_every=null")
    prepared = small_sweep(simulated, tmp_path_factory.mktemp("retention"), POINTS, *words)
    run_small(prepared)
    return prepared


def test_last_and_best_are_kept_and_every_score(finished: Prepared) -> None:
    protocol = finished.settings.protocol.id
    for key, stage in finished.plan.stages.items():
        folder = finished.layout.run(key)
        steps = folder.steps()
        assert len(steps) == stage.epochs
        means = {}
        for step in steps:
            scores = read_scores(folder, step, protocol)
            assert scores is not None
            assert folder.detections(step).exists()
            means[step] = sum(scores[name] for name in MEAN_3D)
        best = max(steps, key=lambda step: (means[step], -step))
        assert {step for step in steps if folder.weights(step).exists()} == {best, steps[-1]}


def test_a_stage_can_be_resumed_from_what_is_kept(finished: Prepared) -> None:
    for key in finished.plan.stages:
        folder = finished.layout.run(key)
        found = last_state(folder)
        assert found is not None
        assert found[1].step == folder.steps()[-1]
