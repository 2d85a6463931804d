"""How a user names the detectors of a comparison."""

from pathlib import Path

import pytest

from fl3d.analysis.detectors import Detector, read_detectors
from fl3d.core.errors import ConfigError


def names(*words: str) -> list[str]:
    return [one.name for one in read_detectors(words)]


def test_a_name_and_its_runs() -> None:
    assert read_detectors(["my detector=a/0, a/1", "b=c"]) == [
        Detector("my detector", (Path("a/0"), Path("a/1"))),
        Detector("b", (Path("c"),)),
    ]


def test_a_folder_alone_has_its_own_name_or_what_tells_it_from_others() -> None:
    assert names("results/mine", "theirs") == ["mine", "theirs"]
    assert names("mine/data", "theirs/data") == ["mine", "theirs"]
    assert names("mine/run0", "theirs/run0", "theirs/run1") == [
        "mine/run0",
        "theirs/run0",
        "theirs/run1",
    ]
    assert names("x=mine/data", "theirs/data") == ["x", "data"]
    assert names("mine/run0", "mine/run0") == ["run0", "run0"]  # refused later, by this name


def test_a_folder_that_is_there_may_hold_any_letters(tmp_path: Path) -> None:
    odd = tmp_path / "lr=0.1,wd=0"
    odd.mkdir()
    assert read_detectors([str(odd), f"b={tmp_path}"])[0] == Detector("lr=0.1,wd=0", (odd,))


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("run0,run1", "several runs of a detector need its name: NAME=run0,run1"),
        ("=run0", "need its name"),
        ("mine=", "a folder is empty"),
        ("mine=run0,,run1", "a folder is empty"),
    ],
)
def test_what_cannot_be_read_is_told(word: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_detectors([word])
