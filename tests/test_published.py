"""No published number outlives its code: trial keys of committed scores are those that the code plans today."""

import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

from fl3d.api.outdated import planned_today
from fl3d.api.publishing import by_folder, read_sweeps
from fl3d.config.compose import CONF
from fl3d.config.places import PUBLISHED
from fl3d.papers.published import SWEEPS
from fl3d.papers.stamp import files_of, read_stamp
from fl3d.runs.plans import read_plan
from fl3d.simulator import VERSION

FILES = sorted(PUBLISHED.glob("*/scores/*.json"))
COMMITTED_BYTES = 6_000_000  # of all results; a clone should stay small


def test_something_is_published() -> None:
    assert {"gamma"} <= {file.stem for file in FILES} <= set(SWEEPS)


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parts[-3]}-{file.stem}")
def test_published_trials_are_those_that_the_code_plans_today(file: Path) -> None:
    folder = file.parent.parent
    stamp = read_stamp(folder)
    assert stamp["versions"]["simulator"] == VERSION
    keys, protocol = planned_today(folder, file.stem)
    assert [trial.key for trial in read_plan(file).trials] == keys
    assert stamp["sweeps"][file.stem]["protocol"] == protocol


@pytest.mark.parametrize(
    "folder", sorted({file.parent.parent for file in FILES}), ids=lambda folder: folder.name
)
def test_every_published_file_is_told_from_those_of_other_sweeps(folder: Path) -> None:
    """By the stamp's lists, or by names: then tables and figures of papers are nobody's."""
    stamp = read_stamp(folder)
    assert set(stamp["sweeps"]) == {path.stem for path in folder.glob("scores/*.csv")}
    files = [path for path in folder.rglob("*") if path.is_file() and path != folder / "stamp.json"]
    named = {name: files_of(folder, stamp, name) for name in stamp["sweeps"]}
    assert {path for own in named.values() for path in own} <= set(files)
    for path in files:
        of = [name for name, own in named.items() if path in own]
        called = [name for name in named if name in path.name]  # gamma and gamma_pointrcnn
        if called:
            assert of == [max(called, key=len)]


def test_a_sweep_is_published_with_those_on_the_same_data() -> None:
    """A folder is emptied before: that of one kind of data must not be taken for another's."""
    names = ["gamma", "gamma_pedestrian", "loss_form"]
    own, people = folders_of(names).items()
    assert own == ("simulated-quick", ["gamma", "loss_form"])
    assert people == ("simulated_people-quick", ["gamma_pedestrian"])
    on_kitti = folders_of(reversed(names), "data=kitti")
    assert on_kitti == {"kitti-quick": ["gamma", "loss_form", "gamma_pedestrian"]}


def folders_of(names: Iterable[str], *words: str) -> dict[str, list[str]]:
    folders = by_folder(read_sweeps(list(names), words))
    return {folder.name: list(own) for folder, own in folders.items()}


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize("given", [[], ["DATA=kitti"]])
def test_make_leaves_a_sweep_its_own_data_unless_others_are_given(given: list[str]) -> None:
    asked = ["make", "--dry-run", "-C", str(CONF.parent), "sweep-gamma_pedestrian", *given]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    [trained] = [line for line in done.stdout.splitlines() if "+sweep=gamma_pedestrian" in line]
    assert [word for word in trained.split() if word.startswith("data=")] == [
        word.lower() for word in given
    ]


def test_what_is_committed_stays_small() -> None:
    assert (
        sum(path.stat().st_size for path in PUBLISHED.rglob("*") if path.is_file())
        < COMMITTED_BYTES
    )
    assert not list(PUBLISHED.rglob("*.html"))


def test_every_grid_of_the_sweep_files_can_be_published() -> None:
    grids = {
        path.stem
        for path in (CONF / "sweep").glob("*.yaml")
        if "OptunaSweeper" not in path.read_text()
    }
    assert set(SWEEPS) == grids
