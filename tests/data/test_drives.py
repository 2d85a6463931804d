"""Which drive a frame was recorded on."""

from pathlib import Path

import pytest

from fl3d.core.errors import DataError
from fl3d.data.drives import has_mapping, read_drives

LINES = (
    "2011_09_26 2011_09_26_drive_0005_sync 0000000109",
    "2011_09_26 2011_09_26_drive_0005_sync 0000000002",
    "2011_09_28 2011_09_28_drive_0034_sync 0000000071",
)


def write_mapping(folder: Path, order: str = "3,1,2", lines: tuple[str, ...] = LINES) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "train_rand.txt").write_text(order)
    (folder / "train_mapping.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("order", ["3,1,2", "3, 1, 2\n", "3\n1\n2\n"])
def test_frame_i_is_the_line_that_number_i_names(tmp_path: Path, order: str) -> None:
    folder = write_mapping(tmp_path, order)
    assert has_mapping(folder)
    drives = [line.split()[1] for line in LINES]
    assert read_drives(folder, ["000000", "000002"]) == [drives[2], drives[1]]
    assert read_drives(folder, ["000001", "000000"]) == [drives[0], drives[2]]
    assert read_drives(folder, []) == []


@pytest.mark.parametrize("name", ["train_rand.txt", "train_mapping.txt"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    folder = write_mapping(tmp_path)
    (folder / name).unlink()
    assert not has_mapping(folder)
    with pytest.raises(DataError, match=name):
        read_drives(folder, ["000000"])


def test_what_is_no_number_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"train_rand\.txt.*'two' is not a line number"):
        read_drives(write_mapping(tmp_path, "3,1,two"), ["000000"])


def test_a_frame_beyond_the_end_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no drive of frame 000003: these are 3 frames"):
        read_drives(write_mapping(tmp_path), ["000000", "000003"])
    with pytest.raises(DataError, match="no drive of frame left_7"):
        read_drives(write_mapping(tmp_path), ["left_7"])


@pytest.mark.parametrize("place", [0, 4])
def test_a_number_without_its_line_is_told(tmp_path: Path, place: int) -> None:
    with pytest.raises(DataError, match="no drive of frame 000001"):
        read_drives(write_mapping(tmp_path, f"3,{place},2"), ["000001"])


def test_a_line_of_other_words_is_named_by_its_number(tmp_path: Path) -> None:
    folder = write_mapping(tmp_path, lines=(*LINES[:2], "drive_0034 71"))
    assert len(read_drives(folder, ["000001", "000002"])) == 2
    with pytest.raises(DataError, match=r"train_mapping\.txt:3.*'drive_0034 71' is not a date"):
        read_drives(folder, ["000000"])


def test_kittis_validation_split_was_recorded_on_45_drives(kitti_sample: Path) -> None:
    """And no drive of it is one of the train split's."""
    ids = {
        split: (kitti_sample / "ImageSets" / f"{split}.txt").read_text().split()
        for split in ("train", "val")
    }
    found = {split: read_drives(kitti_sample / "mapping", own) for split, own in ids.items()}
    counts = sorted(found["val"].count(drive) for drive in set(found["val"]))
    assert (len(counts), sum(counts), counts[-1]) == (45, 3769, 577)
    assert set(found["train"]).isdisjoint(found["val"])
