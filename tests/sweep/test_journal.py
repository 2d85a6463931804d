"""The journal of a study: torn ends, damaged lines, full disks, and files that are none."""

import errno
import os
import sqlite3
from pathlib import Path

import pytest

from fl3d.core.errors import StoreError
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.sweepers.journal import Journal, open_journal
from fl3d.sweep.sweepers.study_storage import open_storage
from tests.sweep.studies import NAME, World, make, states


def begun(root: Path) -> Path:
    """The journal of a study that has two trials done of four."""
    World(make(root, n_trials=2), slots=1, epochs=1).run(8)
    return StoreFolder(root).study(NAME)


@pytest.mark.parametrize(
    "torn",
    [b'{"op_code":6,"worker_id":"a', b'{"op_code":6,"worker_id":"a\n', b"{", b"\0" * 300, b"{}\n"],
)
def test_a_torn_last_line_is_put_aside_and_the_study_goes_on(tmp_path: Path, torn: bytes) -> None:
    path = begun(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole + torn)
    study = make(tmp_path, n_trials=4)
    assert any(f"{path}: its last line was torn" in note for note in study._notes)
    assert path.read_bytes().startswith(whole)
    assert path.with_name(f"{path.name}.torn").read_bytes() == torn.rstrip(b"\n") + b"\n" or (
        path.with_name(f"{path.name}.torn").read_bytes() == torn + b"\n"
    )
    World(study, slots=1, epochs=1).run(10)
    assert states(study) == ["COMPLETE"] * 4
    assert states(make(tmp_path, n_trials=4)) == ["COMPLETE"] * 4


@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_last_line_that_was_cut_off_is_put_aside(tmp_path: Path, cut: int) -> None:
    path = begun(tmp_path)
    path.write_bytes(path.read_bytes()[:-cut])
    study = make(tmp_path, n_trials=4)
    World(study, slots=1, epochs=1).run(10)
    assert states(study).count("COMPLETE") == 4
    assert set(states(study)) <= {"COMPLETE", "FAIL"}


def test_another_process_that_lives_does_not_write_behind_a_torn_line(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=3)
    world = World(study, slots=1, epochs=2).run(2)
    path = StoreFolder(tmp_path).study(NAME)
    with path.open("ab") as file:  # as another that was killed leaves it
        file.write(b'{"op_code":7,"wor')
    for _ in range(20):
        world.tick()
    assert states(study) == ["COMPLETE"] * 3
    assert states(make(tmp_path, n_trials=3)) == ["COMPLETE"] * 3


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = make(tmp_path, n_trials=3)
    path = StoreFolder(tmp_path).study(NAME)
    whole = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("fl3d.sweep.sweepers.journal.os.fsync", full)
        with pytest.raises(StoreError, match=rf"{path}: cannot be written \(No space left"):
            study.advise({}, 1)
    assert path.read_bytes() == whole
    study = make(tmp_path, n_trials=3)
    World(study, slots=1, epochs=1).run(10)
    assert states(study) == ["COMPLETE"] * 3


@pytest.mark.parametrize("line", [b"{torn\n", b"[]\n", b"\n", b"\xff\xfe\n", b'{"op_code":1}\n'])
def test_a_damaged_line_in_the_middle_is_named_and_nothing_is_changed(
    tmp_path: Path, line: bytes
) -> None:
    path = begun(tmp_path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], line, *lines[3:]]))
    damaged = path.read_bytes()
    with pytest.raises(
        StoreError, match=rf"{path}:4: .* is no entry of an Optuna journal"
    ) as error:
        make(tmp_path)
    assert "hydra.sweeper.study_name" in str(error.value)
    assert path.read_bytes() == damaged


@pytest.mark.parametrize(
    "content",
    [
        b"SQLite format 3\0" + bytes(100),
        b"hello",
        b"a,b\n1,2\n",
        b'{"op_code":99,"worker_id":"w"}\n',
        b'{"op_code":5,"worker_id":"w"}\n',
    ],
)
def test_a_file_that_is_no_journal_is_named_and_left_as_it_is(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "study.log"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=f"{path}.*give another hydra.sweeper.study_name"):
        open_journal(path, print)
    assert path.read_bytes() == content


def test_an_empty_file_is_an_empty_journal(tmp_path: Path) -> None:
    path = StoreFolder(tmp_path).study(NAME)
    path.parent.mkdir()
    path.touch()
    study = make(tmp_path, n_trials=1)
    World(study, slots=1, epochs=1).run(5)
    assert states(study) == ["COMPLETE"]


def test_a_folder_in_the_journals_place_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "study.log").mkdir()
    with pytest.raises(StoreError, match=r"study\.log: the journal .* cannot be read or written"):
        open_journal(tmp_path / "study.log", print)


def test_long_last_lines_are_found_whole(tmp_path: Path) -> None:
    path = tmp_path / "study.log"
    entry = (
        b'{"op_code":0,"worker_id":"' + b"w" * 200_000 + b'","study_name":"a","directions":[2]}\n'
    )
    path.write_bytes(entry * 2 + b"{" * 70_000)
    Journal(path, lambda _: None)
    assert path.read_bytes() == entry * 2


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("study.log", "Possible: postgresql"),
        ("oracle://host/db", "Possible: postgresql"),
        ("sqlite:////nowhere/at/all.db", "cannot be opened"),
        ("postgresql://me:secret@127.0.0.1:1/db", "me:"),  # the driver may not be installed
    ],
)
def test_a_database_that_cannot_be_opened_is_a_sentence(
    tmp_path: Path, url: str, says: str
) -> None:
    with pytest.raises(StoreError, match=says) as error:
        open_storage(url, tmp_path, None, "name")
    assert "hydra.sweeper.storage" in str(error.value)
    assert "secret" not in str(error.value)


def test_a_damaged_database_of_a_study_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "study.db").write_bytes(b"this is no database, but it is long enough" * 40)
    with pytest.raises(StoreError, match=r"study\.db is damaged, or no database"):
        open_storage(f"sqlite:///{tmp_path}/study.db", tmp_path, None, "name")


@pytest.mark.parametrize("revision", ["v9.9.9.a", "v2.6.0.a"])
def test_a_database_of_another_optuna_is_a_sentence(tmp_path: Path, revision: str) -> None:
    url = f"sqlite:///{tmp_path}/study.db"
    open_storage(url, tmp_path, None, "name")
    with sqlite3.connect(tmp_path / "study.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", (revision,))
    connection.close()
    with pytest.raises(StoreError, match=r"study\.db.*another version of Optuna"):
        open_storage(url, tmp_path, None, "name")


def test_a_journal_that_vanishes_in_a_sweep_is_a_sentence(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=3)
    StoreFolder(tmp_path).study(NAME).unlink()
    with pytest.raises(StoreError, match=rf"the study '{NAME}' .*cannot be reached"):
        study.advise({}, 1)
