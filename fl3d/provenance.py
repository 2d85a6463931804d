"""Where a result comes from: commit, versions, machine."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("torch", "numpy", "numba", "hydra-core", "mlflow")


def provenance() -> dict[str, str]:
    """Tags for a run."""
    tags = {"fl3d.version": version("fl3d"), "fl3d.machine": f"{platform.machine()} {platform.system()}"}
    tags["fl3d.packages"] = " ".join(f"{name}=={version(name)}" for name in PACKAGES)
    commit = _git("rev-parse", "HEAD")
    if commit:
        tags["mlflow.source.git.commit"] = commit
        tags["fl3d.dirty"] = str(bool(_git("status", "--porcelain"))).lower()
    return tags


def _git(*arguments: str) -> str:
    here = Path(__file__).resolve().parent
    try:
        done = subprocess.run(["git", *arguments], cwd=here, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
