"""Run the benchmarks that end within ten minutes altogether, and write their table into README.md.

    make bench                               # those that need no data of anybody
    make bench KITTI=FOLDER FRAMES=FILE      # on real frames where a benchmark takes some: ids, one a line
    python benchmarks/all.py --only input iou_nms

Each is a process of its own on one thread, one after the other, and ends with a line of JSON. A table of these lines
takes the place of what stands between two marks in README.md; all else there stays. A benchmark that fails has a row
that says so, and this script's exit code is then 1. Those of --only have their rows renewed, others keep theirs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- make bench: begin -->", "<!-- make bench: end -->"
HEAD = "| benchmark | found | seconds | where |\n|---|---|---:|---|"
SECONDS = 600  # for all; what is left when its turn comes is a benchmark's own
# Their arguments; KITTI and FRAMES stand for a folder of real frames and a list of them, without which a benchmark that
# needs them is left out.
WITHOUT = {
    "iou_nms": [],
    "input": [],
    "evaluator": ["--without-other"],
    "store": ["--trials", "200"],
    "scale": ["--trials", "1000", "2000"],
    "simulator": ["--quick"],
    "start": [],
    "interval_coverage": ["--quick", "--only", "drives"],
}
WITH = {
    "input": ["--kitti", "KITTI", "--frames", "FRAMES"],
    "pointnet_ops": ["--kitti", "KITTI"],
    "networks": ["--kitti", "KITTI", "--frames", "FRAMES", "--sizes", "quick"],
}


def main() -> int:
    """Run them, and write the table; 1 where one has failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, help="a KITTI folder")
    parser.add_argument("--frames", type=Path, help="a list of its frame ids, one a line")
    parser.add_argument("--only", nargs="+", choices=[*{**WITHOUT, **WITH}], metavar="NAME")
    given = parser.parse_args()
    places = {"KITTI": given.kitti, "FRAMES": given.frames}
    asked = WITHOUT | (WITH if given.kitti and given.frames else {})
    chosen = [name for name in asked if given.only is None or name in given.only]
    rows = read_rows(README.read_text(encoding="utf-8"))
    began, failed = time.monotonic(), []
    for name in chosen:
        arguments = [str(places.get(word, word)) for word in asked[name]]
        row = run(name, arguments, SECONDS - (time.monotonic() - began))
        failed += [name] if row is None else []
        rows[name] = row or f"| `{name}.py` | **failed** | | |"
        text = with_rows(README.read_text(encoding="utf-8"), rows)
        README.write_text(text, encoding="utf-8")
    print(f"Written to {README}." + (f" Failed: {', '.join(failed)}." if failed else ""))
    return 1 if failed else 0


def run(name: str, arguments: Sequence[str], seconds: float) -> str | None:
    """The row of a benchmark; None: it failed, or there was no time for it."""
    print(f"\n{name} {' '.join(arguments)}", flush=True)
    script = Path(__file__).with_name(f"{name}.py")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    started = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, str(script), *arguments],
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            timeout=max(1.0, seconds),
            check=True,
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        print(error, file=sys.stderr, flush=True)
        return None
    print(done.stdout, end="", flush=True)
    return row_of(json.loads(done.stdout.splitlines()[-1]), time.monotonic() - started)


def row_of(told: Mapping[str, Any], seconds: float) -> str:
    """A line of the table, of what a benchmark has told at its end."""
    found = "; ".join(texts(told["found"]))
    where = f"{told['machine']}; {told['commit'][:10]}"
    return f"| `{told['benchmark']}.py` | {found} | {seconds:.0f} | {where} |"


def texts(found: Mapping[str, Any]) -> list[str]:
    """What was found, a text each: of a part its own, in brackets."""
    return [
        f"{key} ({', '.join(texts(value))})" if isinstance(value, Mapping) else f"{key} {value}"
        for key, value in found.items()
    ]


def read_rows(text: str) -> dict[str, str]:
    """The rows that stand between the marks of a text, by benchmark.

    Raises:
        ValueError: a mark is missing.
    """
    inside = text[text.index(BEGIN) + len(BEGIN) : text.index(END)]
    lines = [line for line in inside.splitlines() if line.startswith("| `")]
    return {line.split("`")[1].removesuffix(".py"): line for line in lines}


def with_rows(text: str, rows: Mapping[str, str]) -> str:
    """A text with these rows between its marks, in alphabetical order; all else stays.

    Raises:
        ValueError: a mark is missing.
    """
    table = "\n".join([HEAD, *(rows[name] for name in sorted(rows))])
    before, after = text[: text.index(BEGIN)], text[text.index(END) + len(END) :]
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


if __name__ == "__main__":
    sys.exit(main())
