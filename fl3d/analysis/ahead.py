"""Make what trials contribute ahead of a report, on all cores, and keep it; the report then reads it.

Nothing depends on this but the time: what a worker could not make, the report makes itself, and says what is wrong with
it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import torch

from fl3d.analysis.contributions import Contributions
from fl3d.core.counting import counted
from fl3d.core.errors import Fl3dError
from fl3d.core.processes import KILLED, cores, pool
from fl3d.inference.kept_windows import Place, make_windows, missing_windows
from fl3d.runs.finished import FinishedSweep

# Networks that share a pass over the frames. To read and encode a frame takes as long as a network of profile quick
# takes for it, or half as long (7 ms, beside 7 and 13 of 3D-FCN and VoxelNet); of sixteen networks each bears a
# sixteenth. More would only let a worker that has nothing left wait longer for the other.
AT_ONCE = 16
# Trials and networks below which starting workers, which load torch first, does not pay.
FEW = 8

Run = Callable[..., object]


@dataclass(frozen=True)
class Job:
    """Some work of a report that leaves what it makes in the store.

    Args:
        sweep: place among the sweeps of the report.
        count: how many trials or networks it is about.
        run: called with the sweep and ``given``; a module's own function.
        given: plain values.
        is_last: whether it reads what the others leave, as figures do: it is begun when they are done.
    """

    sweep: int
    count: int
    run: Run
    given: tuple[Any, ...] = ()
    is_last: bool = False


def contribution_jobs(
    place: int, sweep: FinishedSweep, rules: Sequence[str], curves: bool
) -> Iterator[Job]:
    """A job for each trial of which anything is missing.

    Args:
        place: of the sweep.
        sweep: the sweep.
        rules: by which the trials' checkpoints are chosen that are resampled.
        curves: whether curves and halves are wanted too.
    """
    contributions = Contributions(sweep)
    for trial in sweep.trials:
        if contributions.missing(trial, rules, curves):
            yield Job(place, 1, _contribute, (trial.key, tuple(rules), curves))


def window_jobs(
    place: int, sweep: FinishedSweep, wanted: Sequence[Place], whole: Collection[Place]
) -> Iterator[Job]:
    """Jobs for the checkpoints whose windows are missing; arguments as ``missing_windows``."""
    for group in missing_windows(sweep, wanted, whole):
        n_jobs = -(-len(group) // AT_ONCE)
        n_jobs = max(n_jobs, min(cores(), len(group)))
        for number in range(n_jobs):
            own = group[number::n_jobs]
            yield Job(place, len(own), make_windows, (own, [one for one in own if one in whole]))


def make_ahead(sweeps: Sequence[FinishedSweep], jobs: Iterable[Job]) -> None:
    """Do some jobs, the longest first, and show how far they are.

    Args:
        sweeps: that the jobs are of.
        jobs: independent of each other, but for the last.
    """
    todo = sorted(jobs, key=lambda job: -job.count)
    total = sum(job.count for job in todo)
    if cores() == 1 or total < FEW:
        return  # the report makes them as it comes to them
    with (
        counted("what trials contribute", total, "part") as advance,
        suppress(*KILLED),
        pool(min(cores(), len(todo)), _begin, (tuple(sweeps),), _modules(todo)) as workers,
    ):
        for turn in (False, True):
            running = {workers.submit(_do, job): job for job in todo if job.is_last is turn}
            for done in as_completed(running):
                done.result()
                advance(running[done].count)


def _modules(jobs: Sequence[Job]) -> list[str]:
    """Where what the jobs call is; with all that these modules import, torch above all."""
    return sorted({__name__, *(job.run.__module__ for job in jobs)})


_SWEEPS: tuple[FinishedSweep, ...] = ()  # of this worker


def _begin(sweeps: tuple[FinishedSweep, ...]) -> None:
    global _SWEEPS
    _SWEEPS = sweeps
    torch.set_num_threads(1)


def _do(job: Job) -> None:
    with suppress(Fl3dError, OSError):  # the report meets it again, and says so in its place
        job.run(_SWEEPS[job.sweep], *job.given)


def _contribute(sweep: FinishedSweep, key: str, rules: tuple[str, ...], curves: bool) -> None:
    _held(sweep).make(sweep.trial(key), rules, curves)


_HELD: dict[int, Contributions] = {}  # of this worker, by the sweep's id


def _held(sweep: FinishedSweep) -> Contributions:
    if id(sweep) not in _HELD:
        _HELD[id(sweep)] = Contributions(sweep)
    return _HELD[id(sweep)]
