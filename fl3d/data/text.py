"""Files of a dataset as bytes, lines and numbers; what cannot be read is named."""

from __future__ import annotations

import glob
import math
from pathlib import Path

from fl3d.core.errors import DataError, DataMissing

BOM = (
    b"\xef\xbb\xbf"  # UTF-8's byte order mark, which some editors write at the beginning of a file
)
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_bytes(path: Path) -> bytes:
    """All bytes of a file.

    Raises:
        DataMissing: it is not there.
        DataError: it is a folder, or may not be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None


def unreadable(path: Path, error: OSError) -> DataError:
    """What to say of a file that the system does not read."""
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return DataMissing(f"no such file{_beside(path)}", path)
    if isinstance(error, IsADirectoryError):
        return DataError("is a folder, but a file is needed", path)
    return DataError(f"cannot be read ({error.strerror or error})", path)


def _beside(path: Path) -> str:
    """What lies there instead: a link to nothing, or a file of another ending, or of the number with other zeros."""
    try:
        if path.is_symlink():
            return f": a link to {path.readlink()}, which is not there"
        if not path.parent.exists():
            return f": there is no folder {path.parent.name}"
        stem = path.stem
        names = [stem, stem.zfill(6), stem.lstrip("0") or "0"] if stem.isdecimal() else [stem]
        found = {o.name for n in names for o in path.parent.glob(f"{glob.escape(n)}.*")}
        others = sorted(found - {path.name})
    except OSError:
        return ""
    return f" (but {', '.join(others[:3])})" if others else ""


def is_there(path: Path) -> bool:
    """Whether a file or folder is there.

    Raises:
        DataError: the system does not let it be known.
    """
    try:
        return path.exists()
    except OSError as error:
        raise unreadable(path, error) from None


def text_bytes(raw: bytes, path: Path | str) -> bytes:
    """A text file's bytes without a byte order mark.

    Raises:
        DataError: it is UTF-16, or no text at all.
    """
    if raw.startswith(_UTF16):
        raise DataError("is not a text file of UTF-8 but of UTF-16: save it as UTF-8", path)
    zero = raw.find(b"\0")
    if zero >= 0:
        raise DataError(f"is not a text file (a zero at byte {zero}; UTF-16?)", path)
    return raw.removeprefix(BOM)


def read_lines(path: Path) -> list[str]:
    """Lines of a text file of UTF-8, with or without a byte order mark; lines end in LF, CRLF or CR.

    Raises:
        DataError: it is missing, cannot be read, or is not such a text.
    """
    raw = text_bytes(read_bytes(path), path)
    try:
        text = raw.decode()
    except UnicodeDecodeError as error:
        raise DataError(
            f"is not a text file of UTF-8 ({error.reason} at byte {error.start})", path
        ) from None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines if lines[-1] else lines[:-1]  # behind the last line's end there is none


def finite(text: str, field: str, path: Path, line: int) -> float:
    """A field as a finite number, or a DataError that names file, line and field."""
    try:
        value = float(text.replace("_", "?"))  # Python would read 1_0 as 10
    except ValueError:
        raise DataError(f"field '{field}': '{text}' is not a number", path, line) from None
    if not math.isfinite(value):
        raise DataError(f"field '{field}': '{text}' is not finite", path, line)
    return value
