"""What starting costs: CPU seconds of whole commands, the best of several runs each.

    python benchmarks/start.py

`evaluate` is of 3769 made-up frames, three classes, with its functions compiled before. `import numba` and a bare
Python are beside, since nothing that computes here can start faster. The last line is JSON.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from evaluator import make_folders
from told import tell

FRAMES = 3769
TIMES = 5


def cpu_seconds(words: Sequence[object]) -> float:
    """User and system time of a process and its children, the least of several runs."""
    found = []
    for _ in range(TIMES):
        before = os.times()
        subprocess.run(
            [sys.executable, *map(str, words)],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        after = os.times()
        own = after.children_user + after.children_system
        found.append(own - before.children_user - before.children_system)
    return min(found)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        labels, results = make_folders(Path(folder), FRAMES)
        fl3d = ["-m", "fl3d"]
        commands: dict[str, list[object]] = {
            "python -c pass": ["-c", "pass"],
            "import numba": ["-c", "import numba"],
            "fl3d --help": [*fl3d, "--help"],
            "fl3d evaluate --help": [*fl3d, "evaluate", "--help"],
            "fl3d gains --help": [*fl3d, "gains", "--help"],
            "fl3d report --help": [*fl3d, "report", "--help"],
            f"fl3d evaluate, {FRAMES} frames": [*fl3d, "evaluate", labels, results],
        }
        found = {name: cpu_seconds(words) for name, words in commands.items()}
    for name, seconds in found.items():
        print(f"{name:30} {seconds:6.3f} CPU-s")
    tell("start", found)


if __name__ == "__main__":
    main()
