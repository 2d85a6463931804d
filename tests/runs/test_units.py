"""What is drawn again: frames, or drives where they are known and many."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import DataError
from fl3d.runs import units
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.units import Units, units_of
from tests.analysis.making import detected_sweep


@pytest.fixture(scope="module")
def sweep(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    """Four validation frames, which it takes for real ones."""
    root = tmp_path_factory.mktemp("units")
    return detected_sweep(simulated, root, [["detector=voxelnet"]], lambda trial: 0.1)


def with_data(sweep: FinishedSweep, **changes: object) -> FinishedSweep:
    settings = sweep.settings
    return replace(
        sweep,
        settings=replace(settings, data=replace(settings.data, **changes)),  # type: ignore[arg-type]
    )


def mapped(sweep: FinishedSweep, folder: Path, drives: str) -> FinishedSweep:
    """With a mapping that gives the validation frames these drives."""
    ids = sweep.validation.ids
    n_frames = max(int(one) for one in ids) + 1
    (folder / "train_rand.txt").write_text(",".join(str(n + 1) for n in range(n_frames)))
    lines = [f"day drive_of_training {n}" for n in range(n_frames)]
    for frame, drive in zip(ids, drives, strict=True):
        lines[int(frame)] = f"day drive_{drive} {frame}"
    (folder / "train_mapping.txt").write_text("\n".join(lines))
    return with_data(sweep, mapping=folder)


def test_simulated_frames_are_each_of_their_own(sweep: FinishedSweep, tmp_path: Path) -> None:
    """Whatever mapping is at hand."""
    found = units_of(with_data(mapped(sweep, tmp_path, "abcd"), generate=True))
    assert (found.name, found.count) == ("frames", 4)
    assert found.of_frames.tolist() == [0, 1, 2, 3]
    assert found.note == "Resampled: 4 simulated frames, each of its own street."


def test_without_a_mapping_frames_are_taken_as_independent_and_that_is_said(
    sweep: FinishedSweep,
) -> None:
    found = units_of(sweep)
    assert (found.name, found.of_frames.tolist()) == ("frames", [0, 1, 2, 3])
    assert "taken as independent" in found.note
    assert "drives are not known" in found.note
    assert "data.mapping" in found.note


def test_many_drives_are_resampled_with_their_frames(
    sweep: FinishedSweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(units, "FEWEST_DRIVES", 3)
    found = units_of(mapped(sweep, tmp_path, "bacb"))
    assert (found.name, found.count) == ("drives", 3)
    assert found.of_frames.tolist() == [1, 0, 2, 1]
    assert found.note == "Resampled: 3 drives with their 4 frames."


def test_few_drives_are_not(sweep: FinishedSweep, tmp_path: Path) -> None:
    found = units_of(mapped(sweep, tmp_path, "aabb"))
    assert (found.name, found.of_frames.tolist()) == ("frames", [0, 1, 2, 3])
    assert "taken as independent: 2 drives are too few" in found.note
    assert f"at least {units.FEWEST_DRIVES}" in found.note


def test_the_mapping_beside_the_data_is_found(sweep: FinishedSweep, tmp_path: Path) -> None:
    """In ``mapping`` below the data's folder, where its kit has it."""
    own = mapped(sweep, tmp_path, "aaab")
    beside = sweep.kitti().root / "mapping"
    beside.symlink_to(tmp_path)
    try:
        assert "2 drives are too few" in units_of(with_data(own, mapping=None)).note
    finally:
        beside.unlink()


def test_a_mapping_that_does_not_know_a_frame_is_told(sweep: FinishedSweep, tmp_path: Path) -> None:
    own = mapped(sweep, tmp_path, "abcd")
    (tmp_path / "train_rand.txt").write_text("1,2,3")
    with pytest.raises(DataError, match="no drive of frame"):
        units_of(own)


def test_units_are_counted() -> None:
    assert Units("drives", np.array([2, 0, 1, 2]), "").count == 3
    assert Units("frames", np.zeros(0, dtype=np.int64), "").count == 0
