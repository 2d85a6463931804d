"""`benchmarks/gpu.sh` finds fl3d here, and packages wherever they were found before."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

STUB = """#!/bin/sh
if [ "$1" != -c ]; then echo "$PYTHONPATH"; fi
"""


@pytest.mark.parametrize(
    ("before", "then"), [({}, "."), ({"PYTHONPATH": "/packages"}, ".:/packages")]
)
def test_it_adds_to_the_search_path(before: dict[str, str], then: str, tmp_path: Path) -> None:
    for folder in ("benchmarks", "bin"):
        (tmp_path / folder).mkdir()
    shutil.copy(ROOT / "benchmarks" / "gpu.sh", tmp_path / "benchmarks")
    python = tmp_path / "bin" / "python3"
    python.write_text(STUB)
    python.chmod(0o755)
    environment = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", **before}
    command = ["sh", tmp_path / "benchmarks" / "gpu.sh"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == then
