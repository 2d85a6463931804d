"""Folders of the user's own Python modules, which ``_target_`` may name."""

from __future__ import annotations

import sys
from collections.abc import Iterable

_NAMED: list[str] = []  # in the order of ``sys.path``


def make_importable(folders: Iterable[str]) -> None:
    """Let ``_target_`` name modules in folders of the user's own; those that were named first are asked first.

    What the command line names comes before what a stage was trained with: that may have been moved, and another's lie
    there now.
    """
    for folder in folders:
        if folder not in sys.path:
            sys.path.insert(sum(path in _NAMED for path in sys.path), folder)
            _NAMED.append(folder)
