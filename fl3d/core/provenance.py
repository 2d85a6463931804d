"""Where a result comes from: commit, versions, machine."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from fl3d import __version__
from fl3d.core.shipped import is_checkout

PACKAGES = ("torch", "numpy", "numba", "hydra-core", "optuna", "mlflow")


def provenance() -> dict[str, str]:
    """Tags for a run: versions, commit, digest of what is not committed, and the machine."""
    tags = {"fl3d.version": __version__, "fl3d.machine": machine()}
    tags["fl3d.packages"] = " ".join(_versions())
    commit = _git("rev-parse", "HEAD").strip()
    if commit:
        tags["fl3d.commit"] = commit
        tags["fl3d.dirty"] = str(bool(_git("status", "--porcelain").strip())).lower()
        changes = uncommitted()
        if changes:
            tags["fl3d.diff"] = hashlib.sha256(changes.encode()).hexdigest()[:16]
    return tags


def _versions() -> Iterator[str]:
    """``numpy==2.4.6`` of each package that is installed."""
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            yield f"{name}=={version(name)}"


def uncommitted() -> str:
    """Changes of tracked files since the last commit, as a patch; empty where there are none, or no git."""
    return _git("diff", "HEAD", "--no-color", "--no-ext-diff")


def machine() -> str:
    """What results were computed on: host, processor, cores and system."""
    cores = len(os.sched_getaffinity(0))
    return f"{platform.node()}: {_processor()}, {cores} cores, {platform.system()} {platform.release()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def _git(*arguments: str) -> str:
    if not is_checkout():  # what lies around an installed package is somebody else's repository
        return ""
    here = Path(__file__).resolve().parent
    try:
        done = subprocess.run(
            ["git", *arguments],
            cwd=here,
            capture_output=True,
            encoding="utf-8",
            errors="backslashreplace",
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout
