"""What a command prints may be lost, and never ends it: readers that leave, full disks, closed streams, ASCII."""

import errno
import io
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from fl3d.cli import main
from fl3d.core.streams import FITTING, _Lossy, is_terminal, kept, loss

ROOT = Path(__file__).resolve().parent.parent
CLEAN = f"{sys.executable} -m fl3d clean --help"  # the lightest that prints


class Bare:
    """What some notebooks put in the place of a stream: it takes text, and has no descriptor and no terminal."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> int:
        self.text += text
        return len(text)

    def flush(self) -> None:
        pass


def test_a_reader_that_leaves_ends_nothing_and_is_told_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    raw = _Lossy(writing)
    assert raw.write(b"one line\n") == 9
    assert raw.write(b"another\n") == 8
    os.close(writing)
    assert raw.lost is not None
    assert raw.lost.errno == errno.EPIPE
    assert loss(raw.lost) == ("", 141)  # as of whatever SIGPIPE ends


def test_a_full_disk_is_told_once_at_the_end() -> None:
    with open("/dev/full", "wb", buffering=0) as full:
        raw = _Lossy(full.fileno())
        assert raw.lost is None
        raw.write(b"one line\n")
    assert raw.lost is not None
    said, code = loss(raw.lost)
    assert "standard output could not be written (No space left on device)" in said
    assert code == 1


def test_a_slow_reader_loses_nothing() -> None:
    """Streams are sometimes set to not wait; a pipe holds 64 KiB."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    found = io.BytesIO()

    def read() -> None:
        time.sleep(0.05)
        while part := os.read(reading, 10_000):
            found.write(part)

    thread = threading.Thread(target=read)
    thread.start()
    raw = _Lossy(writing)
    with io.BufferedWriter(raw) as out:
        out.write(bytes(range(256)) * 1000)
    os.close(writing)
    thread.join()
    os.close(reading)
    assert raw.lost is None
    assert found.getvalue() == bytes(range(256)) * 1000


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("γ = 0.5 ± 1", b"gamma = 0.5 +/- 1"),
        ("−3 … 2×2 ≥ 1", b"-3 ... 2x2 >= 1"),
        ("├─ focal │ └─", b"|- focal | +-"),
        ("Zürich", b"Zurich"),
        ("点", rb"\u70b9"),
        ("caf\udce9.txt", b"caf\xe9.txt"),  # the name of a file, as the system has it
    ],
)
def test_letters_that_a_stream_does_not_know_stay_readable(text: str, written: bytes) -> None:
    with kept():  # knows how
        assert text.encode("ascii", FITTING) == written


def test_a_stream_of_utf_8_keeps_every_letter() -> None:
    with kept():
        assert "γ 点 \udce9".encode("utf-8", FITTING) == "γ 点 ".encode() + b"\xe9"


def test_a_notebooks_streams_are_used_as_they_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    out, error = Bare(), Bare()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", error)
    (tmp_path / "stages").mkdir()
    main(["clean", f"store.root={tmp_path}"])
    assert (sys.stdout, sys.stderr) == (out, error)
    assert out.text == f"{tmp_path}: there is nothing to delete\n"
    with pytest.raises(SystemExit) as end:
        main(["cleam"])
    assert end.value.code == 2
    assert error.text.startswith("fl3d: 'cleam' is neither KEY=VALUE nor a command")


@pytest.mark.parametrize("stream", [Bare(), io.StringIO(), None])
def test_what_cannot_say_whether_it_is_a_terminal_is_none(stream: object) -> None:
    assert not is_terminal(stream)  # type: ignore[arg-type]


def test_a_closed_stream_is_no_terminal() -> None:
    stream = io.StringIO()
    stream.close()
    assert not is_terminal(stream)


def shell(line: str, **env: str) -> subprocess.CompletedProcess[bytes]:
    paths = {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        ["bash", "-c", line],
        capture_output=True,
        env={**os.environ, **paths, **env},
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("where", "why", "code"),
    [
        (">&-", "it is closed", 1),
        ("> /dev/full", "No space left on device", 1),
        ("| (exec 0<&-)", "", 141),
    ],
)
def test_a_command_whose_output_is_lost_says_so_in_one_line(
    where: str, why: str, code: int
) -> None:
    done = shell(f"({CLEAN}; echo $? >&2) {where}")
    said = done.stderr.decode().splitlines()
    assert said[-1] == str(code)
    assert len(said) == (2 if why else 1)
    assert why in said[0]


def test_errors_end_as_ever_where_nobody_can_be_told() -> None:
    done = shell(f"{sys.executable} -m fl3d cleam >&- 2>&-")
    assert done.returncode == 2
    assert done.stderr == b""


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    """A database that is opened as descriptor 1 would be written into by whoever prints."""
    code = (
        "from fl3d.core.streams import kept\n"
        "with kept():\n"
        f"    file = open({str(tmp_path / 'n')!r}, 'w'); file.write(str(file.fileno())); file.close()"
    )
    done = shell(f'{sys.executable} -c "{code}" <&- >&- 2>&-')
    assert done.returncode == 0
    assert int((tmp_path / "n").read_text()) > 2
