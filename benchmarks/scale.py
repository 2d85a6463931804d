"""What fl3d itself costs for each trial of a large sweep: planning, scheduling, recording, memory.

    python benchmarks/scale.py [--trials 1000 10000 100000]

Nothing is trained: stages end as soon as they are started, and leave the files of one checkpoint behind. The store
keeps nothing, for what MLflow takes is in benchmarks/store.py; pictures of trials are left out. Times are CPU
milliseconds a trial, of this process; what writing the files of the stages takes is measured beside and taken off. A
trial has two stages; the first is shared by all of a seed, and each seed has 100 levels.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from benchmarks.told import tell
from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.core.records import Checkpoint
from fl3d.evaluation.protocol import Protocol
from fl3d.runs.checkpoints import write_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec, write_done, write_scores
from fl3d.store.base import RunStatus, Scored, Store
from fl3d.sweep import run, setup
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.sweep.setup import Prepared, prepare_sweep

LEVELS = 100  # of each seed
SLOTS = 10  # so that there are many turns of the loop
DATA = ("data.train_frames=4", "data.val_frames=2", "profile=tiny")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, nargs="+", default=[1000, 10_000])
    arguments = parser.parse_args()
    run.POLL_SECONDS = 0.0
    assert hasattr(setup, "draw_frame_with_most_objects")
    setup.draw_frame_with_most_objects = lambda *_: lambda *_: []  # type: ignore[assignment]
    with tempfile.TemporaryDirectory() as name:
        measure(LEVELS, Path(name) / "warm")  # the data are simulated, and modules loaded
        rows = [measure(trials, Path(name) / str(trials)) for trials in arguments.trials]
    tell("scale", {f"{row.pop('trials'):,} trials": row for row in rows})


def measure(trials: int, work: Path) -> dict[str, float]:
    """A sweep of so many trials; milliseconds and KiB a trial."""
    before = memory()
    spent: dict[str, float] = {}
    with timed("planning", spent):
        prepared = plan(trials, work)
    planned = memory()
    launcher, store = Fake(prepared), Forgetful()
    with timed("running", spent):
        ran = run.run_sweep(prepared, launcher, store, say=lambda line: None)
    spent["running"] -= launcher.seconds
    assert len(ran.outcome.trained) == len(prepared.plan.stages)
    assert store.finished == trials
    row = {"trials": trials, "stages": len(prepared.plan.stages)}
    row |= {f"{name} ms": round(1000 * value / trials, 3) for name, value in spent.items()}
    row["planned KiB"] = round((planned - before) / trials, 2)
    row["run KiB"] = round((memory() - planned) / trials, 2)
    print(", ".join(f"{name} {value}" for name, value in row.items()), flush=True)
    return row


def plan(trials: int, work: Path) -> Prepared:
    """A grid of levels and seeds."""
    seeds = trials // LEVELS
    words = ["detector=voxelnet", f"loss.gamma=range(0,{LEVELS})", f"seed=range(0,{seeds})"]
    places = [f"store.root={work}/runs", f"results={work}/out", f"data.root={work.parent}/data"]
    asked = multirun([*words, *places, *DATA, "sweep.name=scale"])
    sweeper = build(asked.sweeper, "hydra.sweeper").proposer(asked.arguments, asked.compose)
    return prepare_sweep(sweeper)


class Forgetful(Store):
    """Keeps nothing, as one does outside whose process the database is; counts the runs that are finished."""

    exists = True
    is_for_one_machine = True

    def __init__(self) -> None:
        self.finished = 0

    def open(self) -> None:
        """Nothing is needed."""

    def experiment(self, name: str, note: str) -> str:
        """It is called by its name."""
        return name

    def run(self, experiment: str, trial: str, *_: object) -> str:
        """It is called by its trial."""
        return f"{experiment}/{trial}"

    def log(self, run: str, scored: Scored) -> None:
        """Nothing is kept."""

    def logged_steps(self, run: str) -> set[int]:
        """None."""
        return set()

    def link_dataset(self, run: str, name: str, digest: str, root: Path) -> None:
        """Nothing is kept."""

    def log_model(self, experiment: str, run: str, name: str, *_: object) -> str:
        """It is called by its run."""
        return f"{run}/{name}"

    def models(self, experiment: str) -> set[tuple[str, str]]:
        """None."""
        return set()

    def log_files(self, run: str, files: Iterable[Path], folder: str) -> None:
        """Nothing is kept."""

    def set_tags(self, run: str, tags: Mapping[str, str]) -> None:
        """Nothing is kept."""

    def is_finished(self, run: str) -> bool:
        """None was before."""
        return False

    def end(self, run: str, status: RunStatus) -> None:
        """Count it."""
        self.finished += status is RunStatus.DONE

    def read(self, experiment_name: str) -> pd.DataFrame:
        """Nothing was kept."""
        return pd.DataFrame()


class Fake(Launcher):
    """Ends each stage when it is started.

    Args:
        prepared: the sweep.
    """

    slots = SLOTS

    def __init__(self, prepared: Prepared) -> None:
        self.seconds = 0.0  # that writing the files took
        self.protocol = prepared.settings.protocol

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Write what a stage leaves."""
        started = time.process_time()
        leave(RunFolder(folder), self.protocol)
        self.seconds += time.process_time() - started
        return Done()


class Done(Job):
    """A job that has ended."""

    def state(self) -> JobState:
        """It has."""
        return JobState.DONE

    def cancel(self) -> None:
        """Nothing runs."""


def leave(folder: RunFolder, protocol: Protocol) -> None:
    """The files of a stage with one checkpoint."""
    stage = read_spec(folder).stage
    scores = dict.fromkeys(protocol.metric_names, 50.0)
    write_scores(folder, stage.end_step, protocol, scores)
    checkpoint = Checkpoint(
        stage=stage.key,
        step=stage.end_step,
        epoch=stage.start_epoch + stage.epochs,
        lr=0.1,
        losses={"total": 1.0},
        seconds={"training": 1.0, "detection": 1.0, "scoring": 1.0},
        sha256="",
        time_ms=1,
    )
    write_marker(folder, checkpoint)
    write_done(folder, {"started": 0.0, "ended": 1.0})


@contextmanager
def timed(name: str, spent: dict[str, float]) -> Iterator[None]:
    """Add the CPU seconds of a block."""
    started = time.process_time()
    yield
    spent[name] = time.process_time() - started


def memory() -> float:
    """Most memory that this process has had so far, KiB."""
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


if __name__ == "__main__":
    main()
