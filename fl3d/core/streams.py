"""What a command prints: where it cannot be written the command goes on, and says so at its end.

A reader may leave (``| head``), a disk may be full, a terminal may have hung up, a stream may be closed or know ASCII
alone. None of that is a reason to stop a sweep of hours, or to end in a traceback. Only the process's own streams are
looked after: what a notebook or a test has put in their place is left alone.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import io
import os
import select
import sys
import unicodedata
from collections.abc import Iterator
from typing import TextIO

STANDARD = (0, 1, 2)
READER_LEFT = 141  # exit code of a shell for what ended as nobody reads it any more: 128 + SIGPIPE
FITTING = "fl3d.fitting"  # name of the way to write letters that a stream does not know
PLAIN = {
    "γ": "gamma",
    "α": "alpha",
    "β": "beta",
    "η": "eta",
    "ρ": "rho",
    "±": "+/-",
    "×": "x",
    "−": "-",
    "–": "-",
    "≤": "<=",
    "≥": ">=",
    "…": "...",
    "†": "+",
    "·": "*",
    "→": "->",
}


class _Lossy(io.RawIOBase):
    """A file that takes whatever is written, and remembers why it could not be kept.

    Args:
        descriptor: of the file.
        error: why nothing can be written from the beginning; None: it can.
    """

    def __init__(self, descriptor: int, error: OSError | None = None) -> None:
        self._descriptor = descriptor
        self._error = error
        self.lost: OSError | None = None

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        return True

    def write(self, content: object) -> int:
        view = memoryview(content)  # type: ignore[arg-type]
        if self._error is None:
            try:
                return os.write(self._descriptor, view)
            except BlockingIOError:  # somebody has set it so; a reader that is slow is no error
                select.select([], [self._descriptor], [])
                return 0 if not view.nbytes else self.write(content)
            except OSError as error:
                self._error = error
        if view.nbytes:
            self.lost = self._error
        return view.nbytes


class Printed:
    """What became of a command's standard output while ``kept``."""

    def __init__(self) -> None:
        self._raw: _Lossy | None = None

    def watch(self, raw: _Lossy) -> None:
        """Look at a stream's file."""
        self._raw = raw

    @property
    def lost(self) -> OSError | None:
        """Why a part of it could not be written; None: all was."""
        sys.stdout.flush()
        return self._raw.lost if self._raw else None


def loss(error: OSError) -> tuple[str, int]:
    """What is said of output that is lost, and the exit code; nothing is said to whoever stopped reading."""
    if error.errno == errno.EPIPE:
        return "", READER_LEFT
    why = "it is closed" if error.errno == errno.EBADF else os.strerror(error.errno or 0)
    return (
        f"fl3d: standard output could not be written ({why}): a part of what was printed is lost; "
        "what went to files is there"
    ), 1


@contextlib.contextmanager
def kept() -> Iterator[Printed]:
    """Let the process's own standard streams lose what they cannot write, instead of raising."""
    codecs.register_error(FITTING, _fitting)
    closed = _fill()
    before = sys.stdout, sys.stderr
    printed = Printed()
    if sys.stdout is None or sys.stdout is sys.__stdout__:
        sys.stdout, raw = _lossy(sys.stdout, 1, 1 in closed)
        printed.watch(raw)
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        sys.stderr, _ = _lossy(sys.stderr, 2, 2 in closed)
    try:
        yield printed
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


def is_terminal(stream: TextIO) -> bool:
    """Whether a person looks at a stream; a notebook's may not even have an answer."""
    try:
        return stream.isatty()
    except (AttributeError, ValueError):
        return False


def _fill() -> set[int]:
    """Open whichever standard stream is closed: else the next file, such as a database, takes its place."""
    closed = set()
    for descriptor in STANDARD:
        try:
            os.fstat(descriptor)
        except OSError:
            closed.add(descriptor)
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
            os.set_inheritable(opened, True)
    return closed


def _lossy(stream: TextIO | None, descriptor: int, is_closed: bool) -> tuple[TextIO, _Lossy]:
    """A stream of the same form that loses what it cannot write."""
    error = OSError(errno.EBADF, os.strerror(errno.EBADF)) if is_closed else None
    raw = _Lossy(descriptor, error)
    encoding = stream.encoding if stream is not None else "utf-8"
    by_line = descriptor == 2 or raw.isatty()
    if stream is not None:
        with contextlib.suppress(OSError):
            stream.flush()
    buffer = io.BufferedWriter(raw)
    return io.TextIOWrapper(buffer, encoding, FITTING, line_buffering=by_line), raw


def _fitting(error: UnicodeError) -> tuple[str | bytes, int]:
    """Letters in another form: a name for a Greek one, the bare letter for one with an accent, a file name's bytes."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    out = b""
    for letter in error.object[error.start : error.end]:
        if "\udc80" <= letter <= "\udcff":  # a byte of a file's name that is no text
            out += bytes([ord(letter) - 0xDC00])
            continue
        plain = PLAIN.get(letter) or unicodedata.normalize("NFKD", letter)
        ascii_letters = plain.encode("ascii", "ignore")
        out += ascii_letters or letter.encode("ascii", "backslashreplace")
    return out, error.end
