"""The campaigns, whole: `make test-slow`. What they try and have found is told in docs/robust.md."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 3 * 3600


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kills", "malformed", "slow_disk", "clocks", "together"])
def test_a_campaign_finds_nothing(name: str) -> None:
    """In a process of its own: it forks, and adopts what its starts leave behind."""
    command = [sys.executable, "-m", f"tests.campaigns.{name}", "--seed", "0"]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=SECONDS
    )
    assert done.returncode == 0, done.stdout + done.stderr
