"""Kill a sweep again and again, at random moments, and see that nothing is lost.

    python -m tests.kill_campaign --kills 30 --seed 0

Each kill is a SIGKILL of a worker (or their fork server), of the parent, or of all at once; then
the same command resumes the sweep. At the end the tables must be those of an undisturbed sweep to
the byte, and the store must hold each score once.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LONGEST_WAIT = 12.0  # seconds before a kill; the whole sweep takes about 30
VICTIMS = ("worker", "parent", "all")


def command(work: Path) -> list[str]:
    """A sweep of four trials."""
    places = [f"store.root={work}/runs", f"results={work}/results", f"data.root={work}/data"]
    words = ["+sweep=gamma", "profile=tiny", "loss.gamma=0,2", *places]
    return [sys.executable, "-m", "fl3d", "-m", *words]


def results(work: Path) -> dict[str, bytes]:
    """Every file of the results folder."""
    folder = work / "results"
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def checkpoints(work: Path) -> set[str]:
    """Checkpoints that are whole."""
    return {
        f"{p.parts[-3]}/{p.stem}" for p in (work / "runs" / "stages").glob("*/checkpoints/*.json")
    }


def doubled_or_lost(work: Path) -> list[str]:
    """Scores of finished checkpoints that the store does not hold exactly once."""
    connection = sqlite3.connect(work / "runs" / "mlflow.db")
    query = """SELECT t.value, m.step, m.key, COUNT(*) FROM metrics m JOIN tags t USING (run_uuid)
               WHERE t.key = 'fl3d.stages' AND m.key LIKE 'ap_%' GROUP BY t.value, m.step, m.key"""
    found = {(stages, step, key): count for stages, step, key, count in connection.execute(query)}
    keys = {key for _, _, key in found}
    runs = {stages for stages, _, _ in found}
    connection.close()
    wrong = [f"{where} stands {count} times" for where, count in found.items() if count != 1]
    for stages in runs:
        for checkpoint in checkpoints(work):
            stage, step = checkpoint.split("/")
            if stage in stages.split():
                lost = [key for key in keys if (stages, int(step), key) not in found]
                wrong += [f"{checkpoint} {key} is missing" for key in lost]
    return wrong


def members(group: int) -> list[int]:
    """Processes of a group."""
    command = ["pgrep", "-g", str(group)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return [int(pid) for pid in done.stdout.split()]


def kill(process: subprocess.Popen[bytes], victim: str, rng: random.Random) -> None:
    """Send SIGKILL to one worker, the parent, or all."""
    workers = [pid for pid in members(process.pid) if pid != process.pid]
    targets = {"parent": [process.pid], "all": [process.pid, *workers]}.get(victim)
    if targets is None:
        targets = [rng.choice(workers)] if workers else [process.pid]
    for pid in targets:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def campaign(work: Path, kills: int, seed: int) -> list[str]:
    """Run a sweep under kills; returns what went wrong."""
    rng = random.Random(seed)
    wrong: list[str] = []
    done = 0
    process: subprocess.Popen[bytes] | None = None
    seen: set[str] = set()
    while True:
        if process is None or process.poll() is not None:
            if process is not None and process.returncode == 0 and done >= kills:
                return wrong
            log = (work / "log.txt").open("ab")
            process = subprocess.Popen(
                command(work), cwd=ROOT, stdout=log, stderr=log, start_new_session=True
            )
        if done >= kills:
            process.wait(timeout=600)
            continue
        time.sleep(rng.uniform(0, LONGEST_WAIT))
        if process.poll() == 0:  # the sweep was through: from here on it starts afresh
            wrong += _compare(work)
            for name in ("runs", "results"):
                subprocess.run(["rm", "-rf", str(work / name)], check=True)
            seen = set()
            continue
        lost = seen - checkpoints(work)
        wrong += [f"kill {done}: checkpoint {name} has gone" for name in lost]
        seen = checkpoints(work)
        victim = rng.choice(VICTIMS)
        kill(process, victim, rng)
        done += 1
        print(f"kill {done}/{kills}: {victim}, {len(seen)} checkpoints on disk", flush=True)
        if victim != "worker":
            process.wait(timeout=60)


def _compare(work: Path) -> list[str]:
    """What differs from an undisturbed sweep."""
    whole = work / "whole"
    if not whole.exists():
        whole.mkdir()
        (whole / "data").symlink_to(work / "data")
        subprocess.run(command(whole), cwd=ROOT, check=True, capture_output=True, timeout=900)
    expected = results(whole)
    found = results(work)
    names = sorted({*expected, *found})
    wrong = [f"{name} differs" for name in names if expected.get(name) != found.get(name)]
    return wrong + doubled_or_lost(work)


def main() -> None:
    """Run the campaign from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, help="folder to work in; default: a temporary one")
    arguments = parser.parse_args()
    with contextlib.ExitStack() as stack:
        work = arguments.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        work.mkdir(parents=True, exist_ok=True)
        wrong = campaign(work, arguments.kills, arguments.seed) + _compare(work)
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"{arguments.kills} kills: tables equal to the byte, each score once")


if __name__ == "__main__":
    main()
