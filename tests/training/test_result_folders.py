"""Which result folders there are, of which epochs, and when they may be read."""

from pathlib import Path

import pytest

from fl3d.core.errors import DataError
from fl3d.training.result_folders import (
    Numbers,
    ResultFolders,
    Settling,
    check_frames,
    fingerprint,
    is_complete,
    last_by_number,
)

IDS = ("000001", "000004")


def fill(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / f"{name}.txt").write_text("")
    return folder


def folders(root: Path, pattern: str, epochs: int = 12, **numbers: int) -> ResultFolders:
    told = Numbers(**{"first": 1, "each": 1, "before": 0, **numbers})
    return ResultFolders(pattern, {"tag": "a[1]*"}, root, told, epochs)


def test_a_patterns_places_are_no_pattern_and_its_epoch_is_a_number(tmp_path: Path) -> None:
    root = tmp_path / "with [brackets]"
    here = fill(root / "out" / "a[1]*" / "x" / "epoch_003" / "data")
    fill(root / "out" / "a1" / "x" / "epoch_004" / "data")
    fill(root / "out" / "a[1]*" / "x" / "epoch_last" / "data")
    fill(root / "out" / "a[1]*" / "x" / "epoch_5" / "other")
    assert folders(root, "out/{tag}/*/epoch_{epoch}/data").find() == {3: here}


@pytest.mark.parametrize(
    ("numbers", "name", "epoch"),
    [({"first": 0}, "0", 1), ({"before": 8}, "9", 1), ({"each": 500}, "1500", 3), ({}, "12", 12)],
)
def test_numbers_become_epochs_of_the_stage(
    tmp_path: Path, numbers: dict[str, int], name: str, epoch: int
) -> None:
    here = fill(tmp_path / f"step_{name}")
    assert folders(tmp_path, "step_{epoch}", **numbers).find() == {epoch: here}


def test_numbers_that_are_no_epoch_of_the_stage_are_refused(tmp_path: Path) -> None:
    fill(tmp_path / "step_750")
    with pytest.raises(DataError, match=r"is of epoch 1.5, but the stage has epochs 1 to 12"):
        folders(tmp_path, "step_{epoch}", each=500).find()
    with pytest.raises(DataError, match="is of epoch 750, but"):
        folders(tmp_path, "step_{epoch}").find()
    fill(tmp_path / "a" / "3")
    fill(tmp_path / "b" / "3")
    with pytest.raises(DataError, match=r"is of epoch 3 as .*a/3 is"):
        folders(tmp_path, "*/{epoch}").find()


def test_a_folder_is_settled_when_its_files_stay_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("fl3d.training.result_folders.time.monotonic", lambda: now[0])
    here = fill(tmp_path / "x", IDS[0])
    settling = Settling(5)
    assert not settling.is_settled(here, fingerprint(here))
    now[0] += 5
    assert settling.is_settled(here, fingerprint(here))
    (here / f"{IDS[1]}.txt").write_text("Car")
    assert not settling.is_settled(here, fingerprint(here))
    now[0] += 4
    assert not settling.is_settled(here, fingerprint(here))
    (here / f"{IDS[1]}.txt").write_text("Car 1")
    now[0] += 1
    assert not settling.is_settled(here, fingerprint(here))
    now[0] += 5
    assert settling.is_settled(here, fingerprint(here))


def test_a_folder_is_complete_with_the_validation_frames_and_no_others(tmp_path: Path) -> None:
    here = fill(tmp_path / "x", IDS[0])
    assert not is_complete(fingerprint(here), IDS)
    with pytest.raises(DataError, match="no file of 1 of the 2 validation frames: 000004"):
        check_frames(here, IDS)
    fill(here, IDS[1])
    (here / "summary.json").write_text("{}")  # no result file
    assert is_complete(fingerprint(here), IDS)
    check_frames(here, IDS)
    fill(here, "000009")
    assert not is_complete(fingerprint(here), IDS)
    with pytest.raises(DataError, match="1 frames that are no validation frames: 000009"):
        check_frames(here, IDS)


def test_the_last_checkpoint_is_so_by_number(tmp_path: Path) -> None:
    for name in ("epoch_2.pth", "epoch_10.pth", "epoch_9.pth"):
        (tmp_path / name).touch()
    assert last_by_number("*.pth", tmp_path) == tmp_path / "epoch_10.pth"
    assert last_by_number("*.ckpt", tmp_path) is None
