"""What a trial contributes is what its checkpoints give, wherever it was made and however often."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.analysis import ahead
from fl3d.analysis.ahead import contribution_jobs, make_ahead
from fl3d.analysis.contributions import CELL, CUTS, Contributions, above_cut
from fl3d.analysis.rescore import rescore
from fl3d.analysis.samples import compare_sweep
from fl3d.core.errors import DataError
from fl3d.evaluation.detections import Detections, write_detections
from fl3d.evaluation.scoring import compare_stored
from fl3d.evaluation.validation import read_validation
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep, found_cars, resample_sweep
from tests.support import small_sweep

POINTS = [(f"loss.gamma={gamma}", f"seed={seed}") for gamma in (0, 2) for seed in (0, 1)]
N = 20  # resamples


@pytest.fixture(scope="module")
def shared(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    words = ("detector=voxelnet", "sweep.name=small")
    root = tmp_path_factory.mktemp("sweep")
    return detected_sweep(simulated, root, POINTS, lambda trial: 0.3 + trial.seed, *words)


@pytest.fixture
def sweep(shared: FinishedSweep) -> FinishedSweep:
    """Of whose trials nothing is kept yet."""
    for path in kept_files(shared):
        path.unlink()
    return shared


def kept_files(sweep: FinishedSweep) -> dict[Path, bytes]:
    files = sweep.settings.store.root.rglob("kept/*")
    return {path: path.read_bytes() for path in files}


def test_samples_are_those_of_the_comparisons(sweep: FinishedSweep) -> None:
    made = Contributions(sweep, N)
    whole = resample_sweep(compare_sweep(sweep), made.units.of_frames, N)
    for again in (made, Contributions(sweep, N)):  # made, then read
        found = again.samples()
        assert list(found) == list(whole)
        for group, levels in whole.items():
            assert list(found[group]) == list(levels)
            for level, by_seed in levels.items():
                for seed, one in by_seed.items():
                    own = found[group][level][seed]
                    np.testing.assert_array_equal(own.values, one.values)
                    np.testing.assert_array_equal(own.draws, one.draws)


def test_aps_at_cuts_are_those_of_scoring_anew(sweep: FinishedSweep) -> None:
    """Scores of the detections lie between 0.9 and 1: the last two cuts drop some."""
    made = Contributions(sweep, N)
    rows = rescore(sweep, {"score_threshold": CUTS})
    for trial in sweep.trials:
        own = rows[(rows["level"] == trial.level) & (rows["seed"] == trial.seed)]
        assert made.at_cuts(trial).tolist() == own["ap_3d/moderate"].tolist()
    assert rows["ap_3d/moderate"].nunique() > 1


def test_posteriors_are_those_of_the_boxes_that_the_evaluation_gets(
    sweep: FinishedSweep, tmp_path: Path
) -> None:
    """Of four cars the first and the third count; the boxes of the first two hang three metres above them."""
    trial = sweep.trials[0]
    path = trial.folder.detections(trial.last_step)
    shutil.copy(path, tmp_path)
    found = found_cars(sweep.kitti(), sweep.validation.ids, 0.0, 7)
    found.boxes_velo[:2, 2] += 3
    write_detections(path, found)
    own = Contributions(sweep, N).posteriors(trial)
    shutil.copy(tmp_path / path.name, path)
    assert sorted(own.boxes) == sorted(found.scores)
    assert own.hits.tolist() == [found.scores[2]]


@pytest.mark.parametrize("kind", ["standup", "rotated", "3d"])
def test_a_cut_after_suppression_leaves_what_one_before_leaves(
    kind: str, simulated: Path, tmp_path: Path
) -> None:
    """Boxes in heaps around each car, with scores that tie, and more of them than a frame may keep."""
    prepared = small_sweep(simulated, tmp_path, [()], "detector=voxelnet")
    validation = read_validation(prepared.kitti, prepared.data.val_ids)
    cars = found_cars(prepared.kitti, validation.ids, 0.2, 0)
    rng = np.random.default_rng(0)
    boxes = np.repeat(cars.boxes_velo, 8, axis=0)
    boxes[:, :2] += rng.normal(0, 4.0, (len(boxes), 2))
    scores = np.round(rng.uniform(0, 1, len(boxes)), 1)
    many = Detections(cars.frame_ids, np.repeat(cars.frame, 8), boxes, scores)
    protocol = replace(prepared.settings.protocol, nms_kind=kind, max_detections=5)
    whole = compare_stored(many, validation, replace(protocol, score_threshold=0.0))
    counts = []
    for cut in CUTS:
        left = above_cut(whole, cut)
        alone = compare_stored(many, validation, replace(protocol, score_threshold=cut))
        np.testing.assert_array_equal(left.det.offsets, alone.det.offsets)
        np.testing.assert_array_equal(left.det.scores, alone.det.scores)
        # Products of matrices round by the number of their rows.
        np.testing.assert_allclose(left.det.boxes_cam, alone.det.boxes_cam, rtol=0, atol=1e-12)
        np.testing.assert_allclose(left.overlaps.values[2], alone.overlaps.values[2], atol=1e-12)
        assert left.curve("Car", *CELL).ap_r40 == alone.curve("Car", *CELL).ap_r40
        counts.append(len(left.det.types))
    assert counts[0] > counts[-1]


def test_other_detections_are_held_against_the_labels_anew(
    sweep: FinishedSweep, tmp_path: Path
) -> None:
    """And those of the other trials are not."""
    trial, other = sweep.trials[0], sweep.trials[1]
    made = Contributions(sweep, N)
    for one in (trial, other):
        made.make(one, ["last"], curves=True)
    before = kept_files(sweep)
    path = trial.folder.detections(trial.last_step)
    shutil.copy(path, tmp_path)
    write_detections(path, found_cars(sweep.kitti(), sweep.validation.ids, 0.1, 7))
    again = Contributions(sweep, N)
    assert again.missing(trial, ["last"], curves=True)
    assert not again.missing(other, ["last"], curves=True)
    again.make(trial, ["last"], curves=True)
    changed = {path for path, content in kept_files(sweep).items() if content != before[path]}
    assert changed == {one for one in before if one.is_relative_to(trial.folder.path)}
    shutil.copy(tmp_path / path.name, path)
    assert Contributions(sweep, N).missing(trial, ["last"], curves=True)


def test_another_protocol_and_other_labels_are_other_contributions(sweep: FinishedSweep) -> None:
    trial = sweep.trials[0]
    Contributions(sweep, N).make(trial, ["last"], curves=True)
    assert not Contributions(sweep, N).missing(trial, ["last"], curves=True)
    assert Contributions(sweep, N + 1).missing(trial, ["last"], curves=True)
    strict = replace(sweep.protocol, nms_iou=sweep.protocol.nms_iou / 2)
    other = replace(sweep, settings=replace(sweep.settings, protocol=strict))
    assert Contributions(other, N).missing(trial, ["last"], curves=True)
    fewer = replace(sweep)
    moved = replace(sweep.validation, image_sizes=((10, 10), *sweep.validation.image_sizes[1:]))
    vars(fewer)["validation"] = moved
    assert Contributions(fewer, N).missing(trial, ["last"], curves=True)


def test_processes_make_the_same_bytes(
    sweep: FinishedSweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead, "FEW", 1)
    monkeypatch.setattr(ahead, "cores", lambda: 2)
    make_ahead([sweep], contribution_jobs(0, sweep, ["last"], curves=True))
    by_processes = kept_files(sweep)
    assert len(by_processes) == 5 * len(sweep.trials)
    assert not list(contribution_jobs(0, sweep, ["last"], curves=True))
    for path in by_processes:
        path.unlink()
    for trial in sweep.trials:
        Contributions(sweep).make(trial, ["last"], curves=True)
    assert kept_files(sweep) == by_processes


def _leave(sweep: FinishedSweep, place: str) -> None:
    (Path(place) / "left").write_text("by an earlier job")


def _read(sweep: FinishedSweep, place: str) -> None:
    (Path(place) / "read").write_text((Path(place) / "left").read_text())


def test_last_jobs_begin_when_the_others_are_done(
    sweep: FinishedSweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead, "FEW", 1)
    monkeypatch.setattr(ahead, "cores", lambda: 2)
    given = (str(tmp_path),)
    last = ahead.Job(0, 9, _read, given, is_last=True)  # the longest, and so first of its turn
    make_ahead([sweep], [last, ahead.Job(0, 1, _leave, given)])
    assert (tmp_path / "read").read_text() == "by an earlier job"


def test_a_trial_without_detections_is_named(sweep: FinishedSweep, tmp_path: Path) -> None:
    trial = sweep.trials[0]
    path = trial.folder.detections(trial.last_step)
    path.rename(tmp_path / path.name)
    with pytest.raises(DataError, match=f"{trial.key}.*not a file of detections"):
        Contributions(sweep, N).samples()
    shutil.move(tmp_path / path.name, path)
