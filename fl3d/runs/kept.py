"""What was made of a checkpoint once and is kept beside it: made again when anything that it was made of has changed.

A kept file says by a digest what it was made of, and by another that it is whole. What is torn, damaged or out of date
is as if it were not there; nobody misses a kept file that is deleted, but for the time.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fl3d
from fl3d.core.digests import digest, file_digest
from fl3d.core.errors import Unwritable
from fl3d.core.files import write_atomically

Arrays = dict[str, NDArray[Any]]
HEX = 64  # letters of a SHA-256: a file begins with what it was made of, and with the digest of the rest
PACKAGE = Path(fl3d.__file__).parent


def kept(path: Path, made_of: Mapping[str, Any], make: Callable[[], Arrays]) -> Arrays:
    """Arrays as they are kept, or made and then kept.

    Args:
        path: where.
        made_of: plain values that decide what ``make`` gives, such as digests.
        make: gives the arrays. What it raises is raised.
    """
    key = digest(made_of)
    found = _read(path, key)
    if found is not None:
        return found
    made = make()
    with contextlib.suppress(Unwritable):  # a store that is only read, or full, still answers
        write_atomically(path, lambda temporary: _write(temporary, key, made), flush=False)
    return made


def is_kept(path: Path, made_of: Mapping[str, Any]) -> bool:
    """Whether arrays are kept that were made of just this; whether the file is whole shows when it is read."""
    try:
        with path.open("rb") as file:
            return file.read(HEX) == digest(made_of).encode()
    except OSError:
        return False


def code_digest(*places: str) -> str:
    """Identity of a part of fl3d's own code: whoever changes it need not remember to raise a version.

    Args:
        places: rooms or modules of the package, such as ``evaluation`` or ``losses.py``.
    """
    return _code_digest(places)


@cache
def _code_digest(places: tuple[str, ...]) -> str:
    files = [
        file for place in places for file in (PACKAGE / place, *(PACKAGE / place).rglob("*.py"))
    ]
    return digest({str(f.relative_to(PACKAGE)): file_digest(f) for f in files if f.is_file()})


def _write(path: Path, key: str, arrays: Arrays) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    whole = hashlib.sha256(buffer.getbuffer()).hexdigest()
    with path.open("wb") as file:
        file.write(key.encode() + whole.encode())
        file.write(buffer.getbuffer())


def _read(path: Path, key: str) -> Arrays | None:
    try:
        content = path.read_bytes()
    except OSError:
        return None
    body = memoryview(content)[2 * HEX :]
    if content[:HEX] != key.encode():
        return None
    if content[HEX : 2 * HEX] != hashlib.sha256(body).hexdigest().encode():
        return None
    with np.load(io.BytesIO(body)) as stored:
        return dict(stored)
