"""What is written is whole or not there, and what cannot be written says so."""

import errno
import os
import pickle
from pathlib import Path

import pytest

from fl3d.cli import main
from fl3d.core.errors import Unwritable
from fl3d.core.files import check_writable, swap_folder, write_atomically, write_text


def full(path: Path) -> None:
    """A disk that takes half of a file."""
    path.write_text("ha")
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_leaves_what_was_there_and_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "tables.csv"
    write_text(path, "before")
    with pytest.raises(Unwritable) as found:
        write_atomically(path, full)
    assert str(found.value) == (
        f"{path}: cannot be written (No space left on device); what is there is kept: make room, and the same "
        "command goes on from it"
    )
    assert found.value.errno == errno.ENOSPC
    assert path.read_text() == "before"
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        Unwritable, match=r"file/deep/a\.csv: cannot be written \(Not a directory\)$"
    ):
        write_text(tmp_path / "file" / "deep" / "a.csv", "")


def test_the_error_comes_whole_out_of_another_process() -> None:
    error = Unwritable(errno.EROFS, "Read-only file system", "/there")
    again = pickle.loads(pickle.dumps(error))
    assert isinstance(again, Unwritable)
    assert str(again) == str(error) == "/there: cannot be written (Read-only file system)"


def test_a_look_at_a_folder_leaves_nothing_behind(tmp_path: Path) -> None:
    check_writable(tmp_path / "not" / "yet", 1000)
    assert list(tmp_path.iterdir()) == []


def test_a_look_at_a_folder_names_the_place_at_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(Unwritable, match=rf"^{tmp_path}/file: .*Not a directory"):
        check_writable(tmp_path / "file" / "deep")
    monkeypatch.setattr(Path, "write_bytes", lambda path, content: full(path))
    with pytest.raises(Unwritable, match=rf"^{tmp_path}: .*No space left"):
        check_writable(tmp_path / "not" / "yet", 1000)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            PermissionError(errno.EACCES, "Permission denied", "/data"),
            "fl3d: /data: Permission denied",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            "fl3d: a file: cannot be written (No space",
        ),
    ],
)
def test_what_the_system_refuses_ends_a_command_with_a_sentence(
    error: OSError, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wherever it happens: no traceback, exit code 2."""

    def refused(*_: object) -> None:
        raise error

    monkeypatch.setattr("fl3d.runs.cleaning.clean", lambda *_, **__: refused())
    with pytest.raises(SystemExit) as ended:
        main(["clean"])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith(said)


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_a_disk_that_does_not_answer_ends_a_command_with_a_sentence(
    number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody's mistake: exit code 1, and the same command again."""

    def fails(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number), "/data/plan.json")

    monkeypatch.setattr("fl3d.runs.cleaning.clean", fails)
    with pytest.raises(SystemExit) as ended:
        main(["clean"])
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith(f"fl3d: /data/plan.json: {os.strerror(number)}; ")
    assert "run the same command again" in said


def folder_of(path: Path, text: str) -> Path:
    path.mkdir()
    (path / "file").write_text(text)
    return path


@pytest.mark.parametrize("there", [True, False])
def test_a_folder_takes_the_place_of_another_or_of_none(there: bool, tmp_path: Path) -> None:
    place = tmp_path / "place"
    if there:
        folder_of(place, "old")
    swap_folder(folder_of(tmp_path / "made", "new"), place)
    assert [path.name for path in tmp_path.iterdir()] == ["place"]
    assert (place / "file").read_text() == "new"


def test_a_folder_that_cannot_be_moved_leaves_the_other_where_it_was(tmp_path: Path) -> None:
    place = folder_of(tmp_path / "place", "old")
    with pytest.raises(Unwritable, match=rf"^{place}: "):
        swap_folder(tmp_path / "missing", place)
    assert [path.name for path in tmp_path.iterdir()] == ["place"]
    assert (place / "file").read_text() == "old"


def test_what_a_kill_between_two_renamings_put_aside_comes_back(tmp_path: Path) -> None:
    folder_of(tmp_path / ".old-place", "old")
    with pytest.raises(Unwritable):
        swap_folder(tmp_path / "missing", tmp_path / "place")
    assert (tmp_path / "place" / "file").read_text() == "old"
