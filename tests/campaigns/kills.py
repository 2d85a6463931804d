"""Kill sweeps of every kind at random moments of every phase, and see that nothing is lost or doubled.

    python -m tests.campaigns.kills --seed 0 --count 200

Each kill is a SIGKILL of a worker, of the fork server, of a command's program or its guard, of the parent, of an MLflow
server, or of all at once; then the same command resumes. In the end the results are those of an undisturbed sweep to
the byte, the store holds each score once, no run is RUNNING, no process is left, nor a file that nothing removes.
"""

from __future__ import annotations

import os
import random
import time
from collections import Counter
from pathlib import Path

from tests.campaigns import checks
from tests.campaigns.parts import PARTS, Part, forget, share
from tests.campaigns.phases import FIRST, phases
from tests.campaigns.runner import Asked, Found, main
from tests.campaigns.server import Server
from tests.campaigns.starts import Start, descendants, kill, load, orphans

PATIENCE = 20.0  # seconds that a phase is waited for; then whatever phase it is
WITHIN = {"planning": 2.5, "simulating": 1.5, "opening": 1.0, "training": 0.4, "closing": 1.0}
SHORT = 0.03  # seconds within a phase that is not in the table above
LONGEST = 600.0  # seconds that an undisturbed sweep may take
GAVE_UP = "times without making progress"  # what a stage ends with that was killed again and again
PROGRAM_KILLED = ("ended with signal 9", "left no exit code")  # likewise, of a program


class Trial:
    """One part of the campaign.

    Args:
        part: what is disturbed.
        shared: folder that parts share.
        work: folder of its own.
        rng: random numbers.
        found: what comes of it.
    """

    def __init__(
        self, part: Part, shared: Path, work: Path, rng: random.Random, found: Found
    ) -> None:
        self.part, self.shared, self.work = part, shared, work
        self.rng, self.found = rng, found
        self.kills: Counter[tuple[str, str]] = Counter()  # phase, victim
        self.missed: Counter[str] = Counter()  # phases that were waited for and did not come
        self.ended = 0  # sweeps that came to their end
        self.failed: Counter[str] = Counter()  # starts that ended with an error, by what they said
        self.server = Server(work / "mlflow") if part.server else None
        self._seen: set[str] = set()
        self._is_fresh = True  # whether nothing was waited for since the start

    def run(self, count: int, seconds: float) -> None:
        """Kill so often, for so long at most, and compare."""
        self.work.mkdir(parents=True, exist_ok=True)
        try:
            self._undisturbed()
            deadline = time.monotonic() + seconds
            start = None
            while self.kills.total() < count and time.monotonic() < deadline:
                if start is None or not start.is_running:
                    self._judge(start)
                    start = self._start()
                self._kill(start)
            self._finish(start)
        finally:
            if self.server is not None:
                self.server.kill()

    def _start(self) -> Start:
        self._is_fresh = True
        uri = self.server.uri if self.server is not None else ""
        words = self.part.command(self.shared, self.work)
        return Start([word.replace("URI", uri) for word in words], self.work / "log.txt")

    def _undisturbed(self) -> None:
        """The same sweep, left alone: what the others must come to."""
        if self.server is not None:
            self.server.start()
        start = self._start()
        start.wait(LONGEST)
        if start.code != 0:
            raise RuntimeError(f"{self.part.name} fails undisturbed:\n{start.said()}")
        orphans(self._own())
        self.expected = checks.contents(self.work / "results")
        whole = self.work / "whole"
        whole.mkdir()
        (self.work / "runs").rename(whole / "runs")
        forget(self.work)
        if self.server is not None:
            self.server.renew()

    def _own(self) -> list[int]:
        return [self.server.pid] if self.server is not None else []

    def _kill(self, start: Start) -> None:
        """Wait for a phase that had few kills, and kill."""
        aims = [one for one in self.part.aims if self._is_fresh or one not in FIRST]
        self._is_fresh = False
        had = Counter({phase: self.missed[phase] for phase in aims})
        for (phase, _), number in self.kills.items():
            had[phase] += number
        fewest = min(had[phase] for phase in aims)
        aim = self.rng.choice([phase for phase in aims if had[phase] == fewest])
        deadline = time.monotonic() + PATIENCE
        while aim not in phases(self.work, start.began):
            if not start.is_running or time.monotonic() > deadline:
                break
            time.sleep(0.003)
        if not start.is_running:
            self.missed[aim] += 1
            return
        time.sleep(self.rng.uniform(0, WITHIN.get(aim, SHORT)))
        now = phases(self.work, start.began)
        where = aim if aim in now else self.rng.choice(sorted(now) or ["between"])
        victim = self.rng.choice(self.part.victims)
        hit = self._victims(victim, start, now.get(where, set()))
        if not start.is_running or not hit:
            return
        lost = self._seen - checks.checkpoints(self.work / "runs")
        self.found.check(not lost, f"{self.part.name}: checkpoints have gone: {sorted(lost)}")
        self._seen = checks.checkpoints(self.work / "runs")
        kill(hit)
        self.kills[where, victim] += 1
        print(
            f"{time.strftime('%T')} {self.part.name} {self.kills.total()}: {victim} in {where}",
            flush=True,
        )
        self._after(victim, start)

    def _victims(self, victim: str, start: Start, stages: set[int]) -> list[int]:
        """Processes to kill."""
        if self.server is not None and victim == "mlflow":
            return [self.server.pid, *descendants(self.server.pid)]
        below = descendants(start.pid)
        servers = [pid for pid, line in below.items() if "forkserver import main" in line]
        if victim == "parent":
            return [start.pid]
        if victim == "all":
            return [start.pid, *below]
        if victim == "server":
            return servers[:1]
        if victim in ("program", "guard"):
            chosen = [
                pid
                for pid, line in below.items()
                if "example_program.py" in line and ("guard.py" in line) == (victim == "guard")
            ]
            return [self.rng.choice(chosen)] if chosen else []
        workers = [
            pid
            for server in servers
            for pid, line in descendants(server).items()
            if "example_program.py" not in line
        ]
        if not stages & set(workers):
            return [self.rng.choice(workers)] if workers else []
        return [self.rng.choice(sorted(stages & set(workers)))]

    def _after(self, victim: str, start: Start) -> None:
        """Start again what the campaign itself has ended."""
        if victim in ("parent", "all"):
            start.wait(60)
            left = orphans(self._own())
            self.found.check(not left, f"{self.part.name}: orphans after {victim}: {left}")
        if victim == "mlflow" and self.server is not None:
            time.sleep(self.rng.uniform(0, 3))
            self.server.start()

    def _judge(self, start: Start | None) -> None:
        """What a start came to that has ended."""
        if start is None or start.code is None or start.code < 0:
            return
        said = start.said()
        self.found.check(
            "Traceback" not in said, f"{self.part.name}: a traceback (code {start.code}):\n{said}"
        )
        if start.code == 0:
            self._compare()
            forget(self.work)
            self._seen = set()
            if self.server is not None:
                self.server.renew()
            return
        reason = next((text for text in (GAVE_UP, *PROGRAM_KILLED) if text in said), "")
        self.failed[reason or "otherwise"] += 1
        self.found.check(bool(reason), f"{self.part.name}: code {start.code}:\n{said}")

    def _finish(self, start: Start | None) -> None:
        """Resume to the end, and compare for the last time."""
        for _ in range(4):  # a stage that was killed three times is tried again by the next start
            if start is None or not start.is_running:
                if start is not None and start.code == 0:
                    break
                self._judge(start)
                start = self._start()
            start.wait(LONGEST)
        self._judge(start)
        left = orphans(self._own())
        self.found.check(not left, f"{self.part.name}: orphans: {left}")

    def _compare(self) -> None:
        """A sweep that came to its end against the undisturbed one."""
        self.ended += 1
        name, root = self.part.name, self.work / "runs"
        self._tidy()
        found = checks.contents(self.work / "results")
        wrong = [
            f"{one} differs" for one in checks.differing(self.expected, found, self.part.differs)
        ]
        logged = self.work / "mlflow" if self.part.server else root
        wrong += checks.doubled_or_lost(logged) + checks.still_running(logged)
        wrong += checks.running_trials(root)
        wrong += checks.left_over(root, self.work / "whole" / "runs")
        for folder in ("results", "data"):
            wrong += [f"{one} is left over" for one in checks.temporary(self.work / folder)]
        for one in wrong:
            self.found.check(False, f"{name}: {one}")

    def _tidy(self) -> None:
        """Let temporary files of killed processes grow old, and start once more, which removes them."""
        left = checks.temporary(self.work / "results")
        if left:
            for path in left:
                os.utime(path, (0, 0))
            start = self._start()
            start.wait(LONGEST)
            self.found.check(start.code == 0, f"{self.part.name}: again: {start.said()[-500:]}")


def campaign(asked: Asked) -> Found:
    """Kill each kind of sweep equally often."""
    load()
    found = Found()
    shared = asked.work / "shared"
    if not shared.exists():
        share(shared)
    parts = [part for part in PARTS if not asked.only or part.name in asked.only]
    table: Counter[tuple[str, str]] = Counter()
    for number, part in enumerate(parts):
        count = asked.count // len(parts) + (number < asked.count % len(parts))
        rng = random.Random(f"{asked.seed} {part.name}")
        trial = Trial(part, shared, asked.work / part.name, rng, found)
        try:
            trial.run(count, 60 * (asked.minutes or 1e9) / len(parts))
        except RuntimeError as error:
            found.check(False, str(error))
        table += trial.kills
        failed = ", ".join(f"{n} '{text}'" for text, n in trial.failed.items())
        found.figures.append(
            f"{part.name}: {trial.kills.total()} kills, {trial.ended} sweeps ended"
            + (f", starts that failed: {failed}" if failed else "")
        )
    found.figures += _shown(table)
    return found


def _shown(table: Counter[tuple[str, str]]) -> list[str]:
    """Kills by phase and victim, as a table."""
    victims = sorted({victim for _, victim in table})
    rows = [f"| phase | {' | '.join(victims)} |", f"|---|{'---:|' * len(victims)}"]
    for phase in sorted({phase for phase, _ in table}):
        cells = " | ".join(str(table[phase, victim]) for victim in victims)
        rows.append(f"| {phase} | {cells} |")
    return rows


if __name__ == "__main__":
    main(campaign, __doc__, 200)
