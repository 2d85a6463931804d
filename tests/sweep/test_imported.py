"""Result folders that are there already, as trials of a sweep."""

import importlib
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fl3d.commands import gains, verify, why
from fl3d.core.errors import ConfigError, DataError
from fl3d.data.kitti import KittiFolder
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.imported import find_results, read_list
from tests.example_program import results

PATTERN = "{level}/seed{seed}/epoch_{epoch}/data"


@pytest.fixture
def elsewhere(simulated: Path, tmp_path: Path) -> Path:
    """Results of two levels, three seeds and two epochs, by some other program."""
    root = tmp_path / "exp"
    for level in ("0", "0.5"):
        for seed in range(3):
            for epoch in (5, 10):
                folder = root / level / f"seed{seed}" / f"epoch_{epoch}" / "data"
                folder.mkdir(parents=True)
                for name in KittiFolder(simulated).split("val"):
                    labels = (simulated / f"training/label_2/{name}.txt").read_text().splitlines()
                    shift = (1 + float(level)) / epoch
                    (folder / f"{name}.txt").write_text(results(labels, shift, f"{seed} {name}"))
    return root


@pytest.fixture
def words(simulated: Path, tmp_path: Path) -> list[str]:
    return [
        *("sweep.name=theirs", "profile=tiny", "data.generate=false", f"data.root={simulated}"),
        *(f"store.root={tmp_path / 'runs'}", f"results={tmp_path / 'results'}"),
    ]


def bring(source: str, words: list[str]) -> None:
    importlib.import_module("fl3d.commands.import").run([source, "--factor", "gamma", *words])


def test_imported_results_are_trials_as_any_and_come_in_once(
    elsewhere: Path, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bring(str(elsewhere / PATTERN), words)
    said = capsys.readouterr().out
    assert "12 checkpoints of 6 trials; 6 trials are new" in said
    assert "NMS as the programs did it" in said
    assert "| 0.5 | 3 |" in said
    assert "Verdicts on Imported" in said
    own = ["detector=imported", *words]
    gains.run(own)
    verify.run(own)
    assert (
        "12 checkpoints of theirs-simulated-tiny, 18 APs each: every digit"
        in capsys.readouterr().out
    )
    why.run(["last", "gamma=0.5", "seed=2", "3d/moderate", *own])
    said = capsys.readouterr().out
    assert f"{elsewhere}/0.5/seed2/epoch_10/data: sha256" in said
    assert "matches" in said
    assert "DOES NOT" not in said
    folders = {path.name for path in StoreFolder(tmp_path / "runs").stages.iterdir()}
    shutil.move(elsewhere, tmp_path / "moved")
    bring(str(tmp_path / "moved" / PATTERN), words)
    assert "0 trials are new" in capsys.readouterr().out
    assert {path.name for path in StoreFolder(tmp_path / "runs").stages.iterdir()} == folders


def test_two_imports_without_a_name_keep_plans_of_their_own(
    elsewhere: Path, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unnamed = words[1:]
    bring(str(elsewhere / "{level}" / "seed0" / "epoch_5" / "data"), unnamed)
    bring(str(elsewhere / "{level}" / "seed1" / "epoch_5" / "data"), unnamed)
    plans = StoreFolder(tmp_path / "runs").plan_files()
    names = {path.name.removesuffix("-simulated-tiny.json") for path in plans}
    assert len(names) == 2
    said = capsys.readouterr().out
    assert all(f"sweep.name={name}" in said for name in names)  # "Its words: ..."
    for name in names:
        gains.run(["detector=imported", *unnamed, f"sweep.name={name}"])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda at: next(at.glob("0/seed1/epoch_5/data/*")).unlink(), "no file of 1 of the 4 validation frames"),
        (lambda at: (at / "0/seed1/epoch_5/data/123456.txt").touch(), "frames that are no validation frames: 123456"),
        (lambda at: shutil.copytree(at / "0/seed1", at / "0/seed7"), "holds the very files of .*, of another"),
        (lambda at: shutil.copytree(at / "0/seed1/epoch_5", at / "0/seed1/epoch_05"), "same level, seed and epoch as"),
    ],
)  # fmt: skip
def test_results_that_cannot_be_compared_are_refused(
    elsewhere: Path, words: list[str], spoil: Callable[[Path], object], message: str
) -> None:
    spoil(elsewhere)
    with pytest.raises(DataError, match=message):
        bring(str(elsewhere / PATTERN), words)


def test_a_list_says_the_same_as_a_pattern(elsewhere: Path) -> None:
    found = find_results(str(elsewhere / PATTERN))
    lines = [
        f"{one.folder.relative_to(elsewhere)},{one.level},{one.seed},{one.epoch}" for one in found
    ]
    listed = elsewhere / "list.csv"
    listed.write_text("\n".join(["folder,level,seed,epoch", *lines]) + "\n")
    assert read_list(listed) == found
    assert {one.level for one in found} == {0, 0.5}
    listed.write_text("folder,level,seed,epoch\nx,1,one,2\n")
    with pytest.raises(DataError, match=r"list.csv:2: seed 'one' is no whole number"):
        read_list(listed)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"folder,level,seed,epoch\nnothing,1,0,2\n", "list.csv:2: there is no folder 'nothing'"),
        ("folder,level,seed,epoch\nx,1,²,2\n".encode(), "list.csv:2: seed '²' is no whole number"),
        (bytes(range(256)), r"list.csv: is no CSV of text in UTF-8"),
        (b"", "list.csv: lists no folder"),
    ],
)
def test_a_list_that_cannot_be_read_is_named(tmp_path: Path, content: bytes, said: str) -> None:
    listed = tmp_path / "list.csv"
    listed.write_bytes(content)
    with pytest.raises(DataError, match=said):
        read_list(listed)


def test_a_pattern_that_fits_nothing_is_answered_with_what_is_there(elsewhere: Path) -> None:
    with pytest.raises(DataError, match=r"no folder fits the pattern; there is 0.5/, 0/ in"):
        find_results(str(elsewhere / "run_{level}" / "epoch_{epoch}"))
    with pytest.raises(ConfigError, match=r"no place \{sed\}. Did you mean 'seed'"):
        find_results("{level}/{sed}")
