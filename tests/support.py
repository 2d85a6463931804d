"""A sweep small enough for a test: six frames, two steps an epoch."""

import sqlite3
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from fl3d.config.compose import compose_config
from fl3d.core.records import Config
from fl3d.runs.layout import RunFolder
from fl3d.store.base import Store
from fl3d.store.memory import MemoryStore
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.run import Ran, run_sweep
from fl3d.sweep.scheduler import Outcome, Scheduler
from fl3d.sweep.setup import Prepared, machine, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of

SMALL = (
    "profile=tiny",
    "data.generate=false",
    "data.cache_frames=10",
    "schedule.frames_per_epoch=4",
    "schedule.stages.warmup.epochs=2",
    "schedule.stages.focal.epochs=2",
)


def small_config(simulated: Path, root: Path, *overrides: str) -> Config:
    """A resolved config over the simulated fixture, with its store below ``root``."""
    places = [
        f"data.root={simulated}",
        f"store.root={root / 'runs'}",
        f"results={root / 'results'}",
    ]
    return compose_config([*SMALL, *places, *overrides])


def small_sweep(
    simulated: Path, root: Path, points: Sequence[Sequence[str]], *common: str
) -> Prepared:
    """A planned sweep over points, each a list of overrides."""
    listed = [point_of(point, small_config(simulated, root, *common, *point)) for point in points]
    return prepare_sweep(Listed(listed))


def run_small(
    prepared: Prepared, launcher: Launcher | None = None, store: Store | None = None
) -> Ran:
    """Run a sweep without a word, by default in this process and with its scores in memory.

    Raises:
        StageFailed: a stage failed.
    """
    ran = run_sweep(
        prepared,
        launcher or InlineLauncher(),
        store or MemoryStore(prepared.settings.store.root),
        say=lambda line: None,
    )
    ran.outcome.check()
    return ran


def drive(
    scheduler: Scheduler, plan: Plan, tick: Callable[[Plan], Plan] = lambda plan: plan
) -> Outcome:
    """The loop of a sweep, without sweeper and store.

    Args:
        scheduler: of the plan.
        plan: its stages.
        tick: called after each step; returns the plan, grown or as it was.
    """
    try:
        while True:
            scheduler.step(plan)
            plan = tick(plan)
            if scheduler.is_idle(plan):
                return scheduler.outcome
    finally:
        scheduler.close()


def train_stages(prepared: Prepared) -> Outcome:
    """Train the stages of a sweep in this process; nothing is logged, and all weights are kept.

    Raises:
        StageFailed: a stage failed.
    """
    scheduler = Scheduler(machine(prepared), InlineLauncher(), prepared.layout)
    outcome = drive(scheduler, prepared.plan)
    outcome.check()
    return outcome


def train(simulated: Path, root: Path, *points: Sequence[str]) -> tuple[Plan, Path]:
    """Train a small sweep as ``train_stages`` does: its plan and the folder of its stages."""
    prepared = small_sweep(simulated, root, points)
    train_stages(prepared)
    return prepared.plan, prepared.layout.stages


def keeps_locks(file: Path, look: Callable[[], object]) -> bool:
    """Whether a look at a SQLite database leaves this process's connection to it what it has written last.

    Another process that reads and closes takes itself for the last one, and deletes the rest, where the look has given
    up this process's locks.
    """
    reader = (
        f"import sqlite3; c = sqlite3.connect({str(file)!r}); print(*c.execute('SELECT * FROM t'))"
    )

    def seen() -> str:
        own = [sys.executable, "-c", f"{reader}; c.close()"]
        return subprocess.run(own, capture_output=True, text=True, check=True).stdout

    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("CREATE TABLE t (x)")
        connection.execute("INSERT INTO t VALUES (1)")
        look()
        seen()
        connection.execute("INSERT INTO t VALUES (2)")
        return seen() == "(1,) (2,)\n"


def last_weights(stages: Path, key: str) -> bytes:
    """Bytes of a stage's last checkpoint."""
    folder = RunFolder(stages / key)
    return folder.weights(folder.steps()[-1]).read_bytes()
