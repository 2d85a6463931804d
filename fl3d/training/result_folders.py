"""Folders of result files that a program leaves: which there are, of which epoch, and whether they are whole."""

from __future__ import annotations

import contextlib
import glob
import os
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fl3d.core.errors import DataError
from fl3d.runs.layout import ASIDE
from fl3d.training.templates import fill_text, value_text

SHOWN = 12  # names in an error
_EPOCH = "\0"  # stands for the number while a pattern is taken apart

Print = tuple[tuple[str, int, int], ...]  # name, size and time of each file of a folder


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """How a program numbers its epochs.

    Args:
        first: number of the first epoch of a stage.
        each: numbers that make an epoch.
        before: epochs of the stages before, where its numbers go on from them.
    """

    first: int
    each: int
    before: int

    def epoch(self, number: int) -> float:
        """Own epoch of a stage, from 1, that a number means."""
        return number / self.each - self.first + 1 - self.before


class ResultFolders:
    """The result folders of a stage.

    Args:
        pattern: of the folders, see ``Command.results``.
        values: of its places.
        root: what a relative pattern is relative to.
        numbers: how its epochs are numbered.
        epochs: of the stage.
    """

    def __init__(
        self,
        pattern: str,
        values: Mapping[str, Any],
        root: Path,
        numbers: Numbers,
        epochs: int,
    ) -> None:
        filled = fill_text(pattern, {**values, "epoch": _EPOCH}, _escaped)
        self.pattern = str(Path(glob.escape(str(root))) / filled)
        self.shown = self.pattern.replace(_EPOCH, "{epoch}")
        self.numbers = numbers
        self.epochs = epochs
        self._regex = re.compile(pattern_regex(self.pattern, {_EPOCH: r"(\d+)"}))

    def find(self) -> dict[int, Path]:
        """The folders that are there, by epoch of the stage's own, from 1.

        Raises:
            DataError: two of them are of one epoch, or one is of no epoch of the stage.
        """
        found: dict[int, Path] = {}
        for name in sorted(glob.glob(self.pattern.replace(_EPOCH, "*"), recursive=True)):
            match = self._regex.fullmatch(name)
            if match is None or not os.path.isdir(name):
                continue
            path, epoch = Path(name), self.numbers.epoch(int(match[1]))
            if not epoch.is_integer() or not 1 <= epoch <= self.epochs:
                raise DataError(
                    f"is of epoch {epoch:g}, but the stage has epochs 1 to {self.epochs}; detector.first_epoch says "
                    "which number the first has, detector.counts_on whether numbers go on from the stage before, "
                    "detector.numbers_per_epoch how many make an epoch",
                    path,
                )
            other = found.setdefault(int(epoch), path)
            if other != path:
                raise DataError(
                    f"is of epoch {epoch:g} as {other} is; make detector.results tell one of them",
                    path,
                )
        return found

    def place(self) -> Path:
        """The innermost folder of the pattern that is there."""
        place = Path(self.shown.partition("{epoch}")[0] + "x").parent
        while any(mark in str(place) for mark in "*?[") or not place.is_dir():
            place = place.parent
        return place

    def nothing(self) -> str:
        """What is to be said where no folder fits: what is there instead."""
        place = self.place()
        names = sorted(f"{one.name}/" if one.is_dir() else one.name for one in place.iterdir())
        return f"no folder fits detector.results, {self.shown}; there is {_few(names) or 'nothing'} in {place}"


def check_frames(folder: Path, ids: Sequence[str]) -> None:
    """Refuse a result folder of other frames than the validation frames.

    Args:
        folder: of result files.
        ids: of the validation frames.

    Raises:
        DataError: naming those that are missing, or too many.
    """
    there = {name for name, _, _ in fingerprint(folder)}
    missing = [one for one in ids if f"{one}.txt" not in there]
    if missing:
        raise DataError(
            f"has no file of {len(missing)} of the {len(ids)} validation frames: {_few(missing)}; there must be a file "
            "for each frame of {val_split}, an empty one where nothing is found",
            folder,
        )
    refuse_surplus(folder, ids)


def refuse_surplus(folder: Path, ids: Sequence[str]) -> None:
    """Refuse results of frames that are none of the validation frames; see ``check_frames``."""
    there = {name.removesuffix(".txt") for name, _, _ in fingerprint(folder)}
    surplus = sorted(there - set(ids))
    if surplus:
        raise DataError(
            f"has files of {len(surplus)} frames that are no validation frames: {_few(surplus)}; results must be of "
            "the frames of {val_split}, and of no others",
            folder,
        )


def is_complete(files: Print, ids: Sequence[str]) -> bool:
    """Whether some files are those of the validation frames, each of them."""
    return {name for name, _, _ in files} == {f"{one}.txt" for one in ids}


@dataclass
class Settling:
    """Tells when folders have stopped changing.

    Args:
        seconds: for which nothing must have changed.
    """

    seconds: float
    _seen: dict[Path, tuple[Print, float]] = field(default_factory=dict)

    def is_settled(self, folder: Path, files: Print) -> bool:
        """Whether a folder's files are what they were so many seconds ago."""
        now = time.monotonic()
        before = self._seen.get(folder)
        if before is None or before[0] != files:
            self._seen[folder] = (files, now)
            return self.seconds <= 0
        return now - before[1] >= self.seconds


def fingerprint(folder: Path) -> Print:
    """Name, size and time of each text file in a folder, by name; those that vanish meanwhile are left out."""
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".txt") and not entry.name.startswith("."):
                try:
                    about = entry.stat()
                except FileNotFoundError:
                    continue
                found.append((entry.name, about.st_size, about.st_mtime_ns))
    return tuple(sorted(found))


def last_changed(files: Print) -> float:
    """When the last of some files was written: seconds since 1970."""
    return max((time for _, _, time in files), default=0) / 1e9


def newest_besides(folder: Path, root: Path) -> float:
    """When the last file that is none of a result folder's was written: seconds since 1970.

    Args:
        folder: of results; what was put aside counts as little as it does.
        root: below which files are looked for.
    """
    newest = 0
    for place, folders, files in os.walk(root):
        kept = [name for name in folders if ASIDE not in name and Path(place, name) != folder]
        folders[:] = kept
        for name in files:
            with contextlib.suppress(FileNotFoundError):  # a temporary one
                newest = max(newest, Path(place, name).stat().st_mtime_ns)
    return newest / 1e9


def put_aside(folder: Path) -> None:
    """Rename a result folder, so that the program's own are alone."""
    folder.rename(folder.with_name(f"{folder.name}{ASIDE}{int(time.time())}"))


def last_by_number(pattern: str, root: Path) -> Path | None:
    """Of the files that fit a pattern the last, where numbers in names count as numbers; None: none fits."""
    found = [
        Path(name)
        for name in glob.glob(str(Path(glob.escape(str(root))) / pattern), recursive=True)
    ]
    return max(found, key=lambda path: _natural(str(path)), default=None)


def _natural(text: str) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", text)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _escaped(value: Any) -> str:
    text = value_text(value)
    return text if text == _EPOCH else glob.escape(text)


def pattern_regex(pattern: str, marks: Mapping[str, str]) -> str:
    """A glob pattern as a regular expression.

    Args:
        pattern: in which a character stands for each place.
        marks: what fits the place of each such character.
    """
    parts = re.findall(r"\*\*|\[[^\]]*\]|.", pattern, re.DOTALL)
    known = {"**": ".*", "*": "[^/]*", "?": "[^/]", "[[]": r"\[", **marks}
    return "".join(
        known.get(part) or (part if part.startswith("[") and len(part) > 1 else re.escape(part))
        for part in parts
    )


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (f" ... ({len(names)})" if len(names) > SHOWN else "")
