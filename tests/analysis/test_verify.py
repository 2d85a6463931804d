"""Whether the store's digits come out again, from detections and from weights."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fl3d.analysis.verify import checkpoints_of, verify
from fl3d.core.errors import StoreError
from fl3d.evaluation.detections import Detections, read_detections, write_detections
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import open_sweep
from fl3d.store.opening import open_store
from tests.papers.making import Made, aps, finished_sweep
from tests.support import run_small, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]
WORDS = ("sweep.name=mine", "schedule.stages.warmup.epochs=3", "store.keep_every=null")


@pytest.fixture(scope="module")
def finished(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    prepared = small_sweep(simulated, tmp_path_factory.mktemp("verify"), POINTS, *WORDS)
    run_small(prepared, store=open_store(prepared.settings.store.root))
    return open_sweep(prepared.settings)


@contextmanager
def changed(path: Path) -> Iterator[None]:
    """What a test does to a file is undone."""
    whole = path.read_bytes()
    try:
        yield
    finally:
        path.write_bytes(whole)


def test_every_digit_comes_out_again_from_detections_and_from_weights(
    finished: FinishedSweep,
) -> None:
    found = verify(finished, from_weights=True)
    assert not found.wrong
    assert (
        found.checkpoints == 3 + 2 * 2
    )  # the warm-up's, which both trials share, and each trial's own
    assert 3 <= found.from_weights < found.checkpoints
    assert found.metrics == 18


def test_a_shared_checkpoint_is_scored_once(finished: FinishedSweep) -> None:
    places = [(folder.key, step) for folder, step, _ in checkpoints_of(finished)]
    assert len(places) == len(set(places)) == 7
    for folder, step, _ in checkpoints_of(finished):
        assert step in folder.steps()


def test_without_weights_none_is_looked_at(finished: FinishedSweep) -> None:
    assert verify(finished, from_weights=False).from_weights == 0


def test_a_changed_detection_is_found(finished: FinishedSweep) -> None:
    trial = finished.trials[0]
    path = trial.folder.detections(trial.last_step)
    with changed(path):
        ids = read_detections(path).frame_ids
        frame = finished.kitti().frame(ids[0])
        cars = frame.calibration.boxes_to_velo(frame.labels.boxes_cam)
        perfect = Detections(ids, np.zeros(len(cars), np.int64), cars, np.ones(len(cars)))
        write_detections(path, perfect)
        (wrong,) = verify(finished, from_weights=False).wrong
    assert wrong.startswith(f"  {trial.key} step {trial.last_step}: ap_")


def test_files_that_cannot_be_read_are_told_and_the_others_are_verified(
    finished: FinishedSweep,
) -> None:
    """One checkpoint's detections are torn, of another both are whole but the weights."""
    first, second = finished.trials
    detections = first.folder.detections(first.last_step)
    weights = second.folder.weights(second.last_step)
    with changed(detections), changed(weights):
        detections.write_bytes(b"torn")
        weights.write_bytes(weights.read_bytes()[:100])
        found = verify(finished, from_weights=True)
    assert found.checkpoints == 7
    assert len(found.wrong) == 2
    assert f"{detections}: is not a file of detections" in found.wrong[0]
    assert f"{weights}: cannot be read as a checkpoint" in found.wrong[1]


def test_scores_alone_cannot_be_verified() -> None:
    made = [Made(overrides=(f"loss.gamma={gamma}",), scores={1: aps(gamma)}) for gamma in (0, 2)]
    with pytest.raises(StoreError, match="only its scores are here"):
        verify(finished_sweep(("detector=voxelnet",), made), from_weights=False)
