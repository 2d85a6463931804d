"""What is kept is what would be made now, or it is made again."""

from pathlib import Path

import numpy as np
import pytest

from fl3d.runs.kept import Arrays, is_kept, kept

MADE_OF = {"detections": "ab12", "resamples": 5}


class Maker:
    """Gives another number each time."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self) -> Arrays:
        self.times += 1
        return {"values": np.array([1.5, float("nan")]), "times": np.array(self.times)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "00000002-cuts.bin"


def test_what_was_made_is_read_to_the_bit(path: Path) -> None:
    make = Maker()
    assert not is_kept(path, MADE_OF)
    first = kept(path, MADE_OF, make)
    second = kept(path, dict(reversed(MADE_OF.items())), make)
    assert make.times == 1
    assert is_kept(path, MADE_OF)
    assert first.keys() == second.keys()
    for name, values in first.items():
        assert second[name].dtype == values.dtype
        assert second[name].tobytes() == values.tobytes()


def test_whatever_it_was_made_of_has_changed_it_is_made_again(path: Path) -> None:
    make = Maker()
    kept(path, MADE_OF, make)
    for number, change in enumerate(({"detections": "ab13"}, {"resamples": 6}, {"more": None}), 2):
        assert not is_kept(path, MADE_OF | change)
        assert kept(path, MADE_OF | change, make)["times"] == number


def test_a_file_that_lost_or_changed_a_byte_is_made_again(path: Path) -> None:
    """Cut anywhere, or with any one bit turned: in what it was made of, in the digest, in the values."""
    kept(path, MADE_OF, Maker())
    whole = path.read_bytes()
    damaged = [whole[:size] for size in (0, 1, 63, 64, 127, 128, 129, len(whole) - 1)]
    for place in (0, 64, 128, 128 + len(whole) // 2, len(whole) - 1):
        one = bytearray(whole)
        one[min(place, len(one) - 1)] ^= 1
        damaged.append(bytes(one))
    for content in damaged:
        path.write_bytes(content)
        make = Maker()
        kept(path, MADE_OF, make)
        assert make.times == 1
        assert path.read_bytes() == whole


def test_where_nothing_can_be_written_it_is_made_and_not_kept(tmp_path: Path) -> None:
    """A store on a disk that is only read: a file lies where the folder would be."""
    (tmp_path / "kept").write_text("no folder")
    make = Maker()
    for times in (1, 2):
        assert kept(tmp_path / "kept" / "a.bin", MADE_OF, make)["times"] == times


def test_what_cannot_be_made_leaves_nothing(path: Path) -> None:
    def fail() -> Arrays:
        raise ValueError("detections are torn")

    with pytest.raises(ValueError, match="torn"):
        kept(path, MADE_OF, fail)
    assert not path.exists()
