"""Thirty random kills lose nothing."""

import subprocess
import sys

import pytest

from tests.kill_campaign import ROOT


@pytest.mark.slow
def test_thirty_kills_lose_nothing() -> None:
    arguments = [sys.executable, "-m", "tests.kill_campaign", "--kills", "30"]
    done = subprocess.run(
        arguments, cwd=ROOT, capture_output=True, text=True, check=False, timeout=3600
    )
    assert done.returncode == 0, done.stdout + done.stderr
