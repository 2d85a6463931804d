"""What all campaigns share: the command line, a folder to work in, and how they end."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

# As ``fl3d.cli`` has it; set before any library reads it.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Found:
    """What a campaign has come to.

    Args:
        faults: a line each; empty: nothing went wrong.
        figures: what was tried, a line each.
    """

    faults: list[str] = field(default_factory=list)
    figures: list[str] = field(default_factory=list)

    def check(self, is_right: bool, fault: str) -> None:
        """Note a fault unless something is right."""
        if not is_right:
            print(f"FAULT: {fault}", flush=True)
            self.faults.append(fault)


@dataclass(frozen=True)
class Asked:
    """What a campaign is asked for.

    Args:
        work: an empty folder.
        seed: of its random numbers.
        count: how often it tries.
        only: names of its parts; empty: all.
        minutes: after which it tries no more; None: as often as it was asked.
    """

    work: Path
    seed: int
    count: int
    only: tuple[str, ...] = ()
    minutes: float | None = None


def main(campaign: Callable[[Asked], Found], about: str | None, count: int) -> None:
    """Run a campaign from the command line; the exit code is 1 where it has found a fault."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=count, help=f"how often (default {count})")
    parser.add_argument("--work", type=Path, help="folder to work in; default: a temporary one")
    parser.add_argument("--only", nargs="*", default=[], help="parts of it alone")
    parser.add_argument("--minutes", type=float, help="try no more after so long (kills alone)")
    given = parser.parse_args()
    started = time.monotonic()
    with contextlib.ExitStack() as stack:
        work = given.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        work.mkdir(parents=True, exist_ok=True)
        os.chdir(ROOT)
        only = tuple(given.only)
        asked = Asked(work.resolve(), given.seed, given.count, only, given.minutes)
        found = campaign(asked)
    print("\n".join(found.figures))
    print(f"{time.monotonic() - started:.0f} s, {len(found.faults)} faults", flush=True)
    if found.faults:
        sys.exit("\n".join(found.faults))
