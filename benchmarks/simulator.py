"""Frames a second of the simulator: without and with pictures, on one core and on all.

    python benchmarks/simulator.py

Each folder is written by `python -m fl3d simulate` in a process of its own; the start of Python and
its imports, measured with one frame, is taken off.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.told import tell

CORES = len(os.sched_getaffinity(0))
ROWS = (
    (300, 1, ["--no-pictures"]),
    (600, 1, ["--no-pictures"]),
    (1200, CORES, ["--no-pictures"]),
    (150, 1, []),
    (300, CORES, []),
    (100, 1, ["--no-pictures", "--whole-turn"]),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="the first row alone")
    rows = ROWS[:1] if parser.parse_args().quick else ROWS
    found = {}
    start = seconds(1, 1, "--no-pictures")
    print(f"start and one frame: {start:.1f} s")
    for frames, workers, flags in rows:
        taken = seconds(frames, workers, *flags) - start
        what = " ".join(flags) or "with pictures"
        print(
            f"{frames:5d} frames, {workers} workers, {what}: {frames / taken:6.1f} frames/s",
            flush=True,
        )
        found[f"frames/s: {frames}, {what}, {workers} workers"] = frames / taken
    tell("simulator", found)


def seconds(frames: int, workers: int, *flags: str) -> float:
    """Wall seconds of one folder."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "fl3d",
            "simulate",
            str(Path(folder) / "out"),
            "--frames",
            str(frames),
        ]
        started = time.monotonic()
        subprocess.run(
            [*command, "--workers", str(workers), *flags], check=True, capture_output=True
        )
        return time.monotonic() - started


if __name__ == "__main__":
    main()
