"""Eight processes start at once on an empty folder: the same sweep, and eight sweeps that share their stages.

    python -m tests.campaigns.together --seed 0

Each must end with 0, or say in one sentence that another runs the sweep. Each stage is trained once, and the tables of
all are the same.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tests.campaigns import checks
from tests.campaigns.runner import Asked, Found, main
from tests.campaigns.starts import Start, load, orphans

PROCESSES = 8
SECONDS = 1500.0
APART = 0.5  # seconds between the first and the last start, at most


def words(work: Path, number: int, name: str) -> list[str]:
    """A sweep that simulates its frames."""
    return [
        *("-m", "detector=fcn3d", "loss.gamma=0,2", f"sweep.name={name}", "profile=tiny"),
        *("data.train_frames=8", "data.val_frames=6", "schedule.frames_per_epoch=8"),
        *("schedule.epochs.warmup=1", "schedule.epochs.focal=1", "hydra/launcher=inline"),
        *(f"data.root={work / 'data'}", f"store.root={work / 'runs'}"),
        f"results={work / 'results' / str(number)}",
    ]


def note_training(path: Path) -> Callable[[], None]:
    """Note each stage that is trained, by whomever."""

    def patch() -> None:
        from fl3d.training import stage

        run = stage._NetworkRun.run

        def noted(self: stage._NetworkRun) -> None:
            with path.open("a") as file:
                file.write(f"{self.stage.key}\n")
            run(self)

        stage._NetworkRun.run = noted  # type: ignore[method-assign]

    return patch


def race(work: Path, names: list[str], rng: random.Random, found: Found) -> Counter[str]:
    """Start all, and see what each came to."""
    work.mkdir()
    trained = work / "trained.txt"
    starts = []
    for number, name in enumerate(names):
        time.sleep(rng.uniform(0, APART / len(names)))
        log = work / f"log{number}.txt"
        starts.append(Start(words(work, number, name), log, note_training(trained)))
    ends: Counter[str] = Counter()
    for number, start in enumerate(starts):
        start.wait(SECONDS)
        said = start.said()
        about = f"{work.name}: process {number}"
        found.check("Traceback" not in said, f"{about}: a traceback: {said[-500:]}")
        is_refused = start.code == 2 and "in use by process" in said
        found.check(start.code == 0 or is_refused, f"{about}: code {start.code}: {said[-500:]}")
        ends["ended" if start.code == 0 else "refused"] += 1
    stages = Counter(trained.read_text().split())
    twice = {key: count for key, count in stages.items() if count != 1}
    found.check(not twice, f"{work.name}: trained several times: {twice}")
    _compare(work, starts, names, found)
    left = orphans()
    found.check(not left, f"{work.name}: orphans: {left}")
    return ends


def _compare(work: Path, starts: list[Start], names: list[str], found: Found) -> None:
    """Tables of all that ended, and the store."""
    tables: dict[str, bytes] = {}
    for number, (start, name) in enumerate(zip(starts, names, strict=True)):
        if start.code != 0:
            continue
        own = checks.contents(work / "results" / str(number) / "simulated-tiny" / "tables")
        told = {
            key.replace(name, "N"): value.replace(name.encode(), b"N") for key, value in own.items()
        }
        tables = tables or told
        found.check(told == tables, f"{work.name}: tables of process {number} differ")
    found.check(bool(tables), f"{work.name}: nobody has made tables")
    runs = work / "runs"
    for wrong in [*checks.doubled_or_lost(runs), *checks.still_running(runs)]:
        found.check(False, f"{work.name}: {wrong}")
    for folder in ("runs", "results", "data"):
        for wrong in checks.temporary(work / folder):
            found.check(False, f"{work.name}: {wrong} is left over")


def campaign(asked: Asked) -> Found:
    """Both races, so many times."""
    load()
    found = Found()
    rng = random.Random(asked.seed)
    totals: dict[str, Counter[str]] = {"same": Counter(), "alike": Counter()}
    for number in range(asked.count):
        for kind, total in totals.items():
            if asked.only and kind not in asked.only:
                continue
            names = [f"race{i}" if kind == "alike" else "race" for i in range(PROCESSES)]
            total.update(race(asked.work / f"{kind}{number}", names, rng, found))
    for kind, total in totals.items():
        found.figures.append(f"{kind}: {asked.count} times {PROCESSES} processes: {dict(total)}")
    return found


if __name__ == "__main__":
    main(campaign, __doc__, 3)
