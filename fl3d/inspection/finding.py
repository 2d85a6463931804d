"""One thing that is wrong, or odd: where, what, and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from fl3d.core.errors import DataError


class Severity(StrEnum):
    """How bad a finding is."""

    ERROR = "error"  # nothing can be trained, or nothing evaluated
    WARNING = "warning"  # odd, but possible


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong, or odd.

    Args:
        severity: how bad.
        message: what is odd, with numbers.
        advice: what to do; empty where the message says it.
        file: an example; None: the folder as a whole.
        line: of the file.
        files: how many are alike, this one among them.
    """

    severity: Severity
    message: str
    advice: str = ""
    file: Path | None = None
    line: int | None = None
    files: int = 1

    def text(self, root: Path) -> str:
        """On one line, with the file below the folder."""
        where = ""
        if self.file is not None:
            name = self.file.relative_to(root) if self.file.is_relative_to(root) else self.file
            more = f" and {self.files - 1} more" if self.files > 1 else ""
            where = f"{name}{f':{self.line}' if self.line else ''}{more}: "
        advice = f" {self.advice}" if self.advice else ""
        return f"{self.severity}: {where}{self.message}{advice}"


def error(message: str, advice: str = "", file: Path | None = None, files: int = 1) -> Finding:
    """A finding that stops a sweep."""
    return Finding(severity=Severity.ERROR, message=message, advice=advice, file=file, files=files)


def warning(message: str, advice: str = "", file: Path | None = None, files: int = 1) -> Finding:
    """A finding that does not."""
    return Finding(
        severity=Severity.WARNING, message=message, advice=advice, file=file, files=files
    )


def of_problems(problems: Iterable[DataError]) -> list[Finding]:
    """What could not be read: alike problems of a folder's files are one finding."""
    groups: dict[tuple[Path, str], list[DataError]] = {}
    for problem in problems:
        alike = re.sub(r"[\d.e+-]+", "#", _message(problem))
        groups.setdefault((problem.file.parent, alike), []).append(problem)
    return [_of_group(group) for group in groups.values()]


def _of_group(group: Sequence[DataError]) -> Finding:
    first = group[0]
    return Finding(
        severity=Severity.ERROR,
        message=_message(first),
        file=first.file,
        line=first.line,
        files=len(group),
    )


def _message(problem: DataError) -> str:
    """An error's text without its place."""
    place = f"{problem.file}:{problem.line}" if problem.line is not None else f"{problem.file}"
    return str(problem).removeprefix(f"{place}: ")
