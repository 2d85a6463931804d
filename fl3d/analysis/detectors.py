"""Detectors of a comparison, as a user names them: folders of result files, one for each run of training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fl3d.core.errors import ConfigError


@dataclass(frozen=True)
class Detector:
    """A detector, as it stands in a comparison.

    Args:
        name: for people.
        folders: of result files, one for each run of its training.
    """

    name: str
    folders: tuple[Path, ...]


def read_detectors(words: Sequence[str]) -> list[Detector]:
    """Detectors as a user names them: ``NAME=FOLDER``, ``NAME=RUN1,RUN2,RUN3``, or a folder alone.

    A folder alone has its own name; where several share that, the first folder above in which they differ goes with it.

    Raises:
        ConfigError: several runs without a name, or a name or folder that is empty.
    """
    found = []
    alone = [Path(word) for word in words if _is_folder(word)]
    names = _names(alone)
    for word in words:
        if _is_folder(word):
            found.append(Detector(names[Path(word)], (Path(word),)))
            continue
        name, is_named, rest = word.partition("=")
        if not is_named or not name.strip():
            raise ConfigError(
                f"'{word}': several runs of a detector need its name: NAME={word.lstrip('=')}"
            )
        folders = [part.strip() for part in rest.split(",")]
        if not all(folders):
            raise ConfigError(
                f"'{word}': a folder is empty; write NAME=FOLDER or NAME=RUN1,RUN2,RUN3"
            )
        found.append(Detector(name.strip(), tuple(map(Path, folders))))
    return found


def _is_folder(word: str) -> bool:
    """Whether a word is a folder and nothing else; one that is there may hold any letters."""
    return Path(word).is_dir() or not ("=" in word or "," in word)


def _names(folders: Sequence[Path]) -> dict[Path, str]:
    """A name for each folder: the last part of its path, with parts before it until all differ.

    Parts at the end that all share say nothing: ``a/data`` and ``b/data`` are ``a`` and ``b``.
    """
    folders = list(dict.fromkeys(folders))
    parts = {folder: list(folder.resolve().parts) for folder in folders}
    while (
        len(folders) > 1 and len({own[-1] for own in parts.values()}) == 1 and _can_shorten(parts)
    ):
        parts = {folder: own[:-1] for folder, own in parts.items()}
    depth = 1
    while len({tuple(own[-depth:]) for own in parts.values()}) < len(folders):
        if depth > max(map(len, parts.values())):
            break
        depth += 1
    return {folder: "/".join(own[-depth:]) for folder, own in parts.items()}


def _can_shorten(parts: Mapping[Path, list[str]]) -> bool:
    return all(len(own) > 2 for own in parts.values())
