"""Every sweep begins with a look at its data."""

import shutil
from pathlib import Path

import pytest

from fl3d.core.errors import DataError
from fl3d.store.memory import MemoryStore
from fl3d.sweep import checked
from fl3d.sweep.checked import check_start
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.run import run_sweep
from tests.support import small_sweep

POINTS = [["loss.gamma=0"], ["loss.gamma=2"]]


def test_three_lines_are_said_and_a_second_start_reads_them(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared = small_sweep(simulated, tmp_path, POINTS)
    said: list[str] = []
    check_start(prepared, said.append)
    assert [line.split()[0] for line in said] == ["learnt", "evaluated", "points:"]

    def fails(*_: object) -> None:
        raise AssertionError("looked again")

    monkeypatch.setattr(checked, "gather", fails)
    again: list[str] = []
    check_start(prepared, again.append)
    assert again == said
    (kept,) = (tmp_path / "runs" / "checks").glob("*.json")
    for text in ("{", "3", "[]", '{"errors": []}'):  # no look of ours
        kept.write_text(text)
        with pytest.raises(AssertionError, match="looked again"):
            check_start(prepared, again.append)
    changed = small_sweep(simulated, tmp_path, POINTS, "protocol=kitti")
    with pytest.raises(AssertionError, match="looked again"):
        check_start(changed, again.append)


def test_a_sweep_with_nothing_to_learn_ends_before_anything_is_trained(
    simulated: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(simulated, tmp_path / "data")
    for file in (folder / "training" / "label_2").iterdir():
        file.write_text(file.read_text().replace("Car", "Truck"))
    prepared = small_sweep(folder, tmp_path, POINTS)
    store = MemoryStore(prepared.settings.store.root)
    with pytest.raises(DataError, match=r"VoxelNet has nothing to learn.*Truck \d+") as raised:
        run_sweep(prepared, InlineLauncher(), store, say=lambda line: None)
    assert f'python -m fl3d check "{folder}"' in str(raised.value)
    assert not store.runs
    assert not prepared.layout.stages.exists()


def test_an_error_names_its_file(simulated: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(simulated, tmp_path / "data")
    file = sorted((folder / "training" / "label_2").iterdir())[0]
    file.write_text("Car 0 0\n")
    prepared = small_sweep(folder, tmp_path, POINTS)
    with pytest.raises(DataError, match=rf"error: training/label_2/{file.name}:1: 15 fields"):
        check_start(prepared, print)


def test_many_warnings_are_cut_and_counted(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared = small_sweep(simulated, tmp_path, POINTS)
    texts = {"lines": ["a", "b", "c"], "errors": [], "warnings": [f"w{k}" for k in range(7)]}
    monkeypatch.setattr(checked, "_read", lambda path: texts)
    said: list[str] = []
    check_start(prepared, said.append)
    assert said[:8] == ["a", "b", "c", "w0", "w1", "w2", "w3", "w4"]
    assert said[8].startswith("2 more warnings: python -m fl3d check")


def test_what_stood_in_the_way_is_not_remembered(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that may not be read is one thing that a digest of the data does not tell."""
    prepared = small_sweep(simulated, tmp_path, POINTS)

    def refused(*_: object) -> dict[str, list[str]]:
        return {"lines": [], "errors": ["error: cannot be read"], "warnings": []}

    with monkeypatch.context() as broken:
        broken.setattr(checked, "start_texts", refused)
        with pytest.raises(DataError, match="cannot be read"):
            check_start(prepared, lambda line: None)
    said: list[str] = []
    check_start(prepared, said.append)
    assert len(said) == 3
