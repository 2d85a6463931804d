"""Which program a command runs: a digest of its code, by git or by named files."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fl3d.core.digests import digest, file_digest
from fl3d.core.errors import ConfigError

# Files that git does not know yet count where they may be code or settings; outputs of programs do not.
SOURCES = (
    ".py",
    ".pyx",
    ".c",
    ".cc",
    ".cpp",
    ".cu",
    ".h",
    ".sh",
    ".yaml",
    ".yml",
    ".json",
    ".toml",
)
SHOWN = 20  # names in an error


def read_program(asked: Mapping[str, Any], base: Path) -> dict[str, Any]:
    """Find a program and tell which it is.

    Args:
        asked: ``folder``, and ``files``: patterns below it; without files git is asked.
        base: what a relative folder is relative to.

    Returns:
        ``folder`` (absolute), ``files``, ``digest`` and ``about``, a word for people.

    Raises:
        ConfigError: no folder, no such folder, a pattern that fits no file, or neither git nor patterns.
    """
    unknown = set(asked) - {"folder", "files", "digest", "about"}
    if unknown or not asked.get("folder"):
        raise ConfigError(
            f"detector.program: {', '.join(sorted(unknown)) or 'no folder'}; give its folder, and files in it unless "
            "it is a git repository: {folder: /home/me/OpenPCDet} or {folder: ., files: [train.py, model/*.py]}"
        )
    folder = (base / str(asked["folder"])).resolve()
    if not folder.is_dir():
        raise ConfigError(f"detector.program.folder: {folder}: no such folder")
    files = asked.get("files")
    found = _by_git(folder) if files is None else _by_files(folder, files)
    return {"folder": str(folder), "files": files, **found}


def _by_files(folder: Path, patterns: Any) -> dict[str, str]:
    names: set[str] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        fitting = [path for path in folder.glob(pattern) if path.is_file()]
        if not fitting:
            there = sorted(path.name for path in folder.iterdir())
            shown = ", ".join(there[:SHOWN]) + (" ..." if len(there) > SHOWN else "")
            raise ConfigError(
                f"detector.program.files: '{pattern}' fits no file in {folder}, which holds {shown or 'nothing'}"
            )
        names |= {path.relative_to(folder).as_posix() for path in fitting}
    content = {name: file_digest(folder / name) for name in sorted(names)}
    found = digest(content)[:16]
    count = f"{len(content)} file{'' if len(content) == 1 else 's'}"
    return {"digest": found, "about": f"{count}, digest {found}"}


def _by_git(folder: Path) -> dict[str, str]:
    commit = _git(folder, "rev-parse", "HEAD")
    if commit is None:
        raise ConfigError(
            f"detector.program.folder: {folder} is no git repository with a commit; name the files that are the "
            "program: program: {folder: ..., files: [train.py, model/*.py]}"
        )
    changes = _git(folder, "diff", "HEAD", "--no-color", "--no-ext-diff") or b""
    new = (_git(folder, "ls-files", "--others", "--exclude-standard", "-z") or b"").split(b"\0")
    names = sorted(name.decode() for name in new if name)
    sources = [name for name in names if name.endswith(SOURCES)]
    added = {name: file_digest(folder / name) for name in sources}
    text = commit.decode().strip()
    if not changes and not added:
        return {"digest": text, "about": f"commit {text[:12]}"}
    differs = digest([hashlib.sha256(changes).hexdigest(), added])[:16]
    return {"digest": f"{text}+{differs}", "about": f"commit {text[:12]} + changes {differs}"}


def _git(folder: Path, *arguments: str) -> bytes | None:
    """What git answers; None where there is no git, no repository or no commit."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout
