"""Figures that were drawn once and are kept in the store: drawn again when anything that they show has changed.

What a figure shows are the arguments of the function that draws it, the code that draws, and the libraries under it.
Drawing takes a second a figure, and ten where a frame is full of boxes; to read one takes milliseconds.
"""

from __future__ import annotations

import hashlib
import inspect
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fl3d.core.digests import digest
from fl3d.core.files import write_atomically
from fl3d.reports.figures.style import Drawn, settings
from fl3d.runs.kept import Arrays, code_digest, kept

# What draws: the functions themselves, and what they ask for boxes, levels, verdicts and their words.
CODE = ("core", "geometry", "data", "evaluation", "reports", "papers", "runs/drawn.py")
LIBRARIES = ("matplotlib", "numpy", "pandas", "pillow", "fonttools")
ToDraw = partial[Drawn] | partial[Drawn | None]


def drawn(place: Callable[[str], Path | None], path: Path, figure: ToDraw) -> list[Path]:
    """Draw a figure, or write it as it was drawn before; every file of it, none where there is none to draw.

    A file that is there already with the same content is left as it is.

    Args:
        place: where a figure of a name is kept, such as ``FinishedSweep.drawn_as``; None: it is not.
        path: without ending.
        figure: the function that draws, with its arguments.
    """

    def draw(at: Path) -> list[Path]:
        made = figure()
        return [] if made is None else made.write(at)

    keep = place(path.name)
    if keep is None:
        return draw(path)

    def make() -> Arrays:
        with tempfile.TemporaryDirectory() as folder:
            written = draw(Path(folder) / path.name)
            contents = {file.name: file.read_bytes() for file in written}
        return {name: np.frombuffer(one, dtype=np.uint8) for name, one in contents.items()}

    shown = inspect.signature(figure.func).bind(*figure.args, **figure.keywords).arguments
    made_of = {
        "figure": f"{figure.func.__module__}.{figure.func.__qualname__}",
        "name": path.name,
        "given": plain(shown),
        "code": code_digest(*CODE),
        "libraries": _libraries(),
    }
    found = kept(keep, made_of, make)
    return [_write(path.parent / name, content.tobytes()) for name, content in found.items()]


def _write(path: Path, content: bytes) -> Path:
    if not (path.is_file() and path.read_bytes() == content):
        write_atomically(path, lambda temporary: temporary.write_bytes(content))
    return path


@cache
def _libraries() -> str:
    """Versions of what draws, and how the user has set it up."""
    return digest([{name: version(name) for name in LIBRARIES}, settings()])


def plain(value: Any) -> Any:
    """Plain values that are equal where some values look alike, down to types, order and the last bit.

    Args:
        value: numbers, text, paths, arrays, frames of pandas, and records, mappings and sequences of such.

    Raises:
        TypeError: it is something else, of which nobody knows whether it has changed.
    """
    if isinstance(value, np.ndarray) and value.dtype != object:
        whole = hashlib.sha256(value.tobytes()).hexdigest()
        return ["array", str(value.dtype), list(value.shape), whole]
    if isinstance(value, np.ndarray):
        return ["objects", list(value.shape), [plain(item) for item in value.flat]]
    if isinstance(value, pd.DataFrame):
        columns = [[plain(name), plain(column.to_numpy())] for name, column in value.items()]
        return ["frame", plain(value.index.to_numpy()), columns]
    if value is None or isinstance(value, bool | int | float | str | Path | Enum | np.generic):
        return [type(value).__name__, repr(value)]  # 1 and 1.0 are written differently
    if is_dataclass(value) and not isinstance(value, type):
        parts = [[one.name, plain(getattr(value, one.name))] for one in fields(value)]
        return [type(value).__name__, parts]
    if isinstance(value, Mapping):
        return ["mapping", [[plain(key), plain(item)] for key, item in value.items()]]
    if isinstance(value, Sequence):
        return ["sequence", [plain(item) for item in value]]
    raise TypeError(f"{type(value).__name__}: whether a figure of it has changed cannot be told")
