"""Seeds in rounds, until each level has its verdict: a grid, trained under as many seeds as that takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from fl3d.config.overrides import values_by_key
from fl3d.core.errors import ConfigError
from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.rounds import Place, decided, listed, round_text, time_text
from fl3d.runs.design import SEED, level_text
from fl3d.sweep.sweepers.base import (
    Advice,
    Compose,
    Evidence,
    Point,
    Standing,
    Sweeper,
    TrialState,
    Work,
)
from fl3d.sweep.sweepers.grid import expand, point_of
from fl3d.sweep.sweepers.rounds import Rounds, rounds_of

HOUR = 3600.0
At = Callable[[Sequence[str], int], Point]


@dataclass
class Cell:
    """A group and level of the grid.

    Args:
        overrides: of its point, without the seed.
        seeds: that were proposed.
    """

    overrides: tuple[str, ...]
    seeds: set[int] = field(default_factory=set)


class UntilDecided(Sweeper):
    """Trains a grid under a few seeds, and then those levels further that have no verdict.

    A round has ended when all its trials have. Then each level is judged as ``gains`` judges it; those that are open
    get the next seeds, and the baseline of their group with them. Nothing is kept but the plan and the stages: a later
    start goes through the same rounds, finds them trained, and goes on where the one before ended.

    - **Error**: it is spent over the looks, so that at most 5 % of sweeps without any true gain end in a false verdict
      (``benchmarks/verdicts.py``). The looks are the rounds up to ``most``, and those of earlier starts. A later start
      with a larger ``most`` goes on, and says that the looks before took more than their share.
    - **Failures**: a replicate that failed leaves its pair out. A level without any pair is given up, since another
      seed would most probably fail too; a later start tries again.
    - **Frames too few**: a level is given up before ``most`` where seeds surely cannot decide, see
      ``evaluation.verdicts.is_hopeless``: training for a verdict that cannot come is waste. That about so many seeds
      more than ``most`` are needed stops nothing, since after three seeds such a guess is worth little.
    - **Hours** are those of all stages of the sweep, whoever trained them. A round that is trained already is taken in
      any case, for it costs nothing.

    Args:
        grid: overrides of its points, without a seed.
        at: makes a point of overrides and a seed.
        start: the first seed.
        rounds: how seeds are added.

    Raises:
        ConfigError: nothing is compared.
    """

    def __init__(self, grid: Sequence[Sequence[str]], at: At, start: int, rounds: Rounds) -> None:
        if len(grid) < 2:
            raise ConfigError(
                "hydra/sweeper=until_decided holds levels against a baseline: sweep a key, such as loss.gamma=0,2"
            )
        self.rounds = rounds
        self.looks = rounds.looks
        self.n_trials = len(grid) * rounds.most
        seeds = range(start, start + rounds.first)
        self._first = [at(overrides, seed) for overrides in grid for seed in seeds]
        self.base = self._first[0].config
        self.swept = tuple(self._first[0].values)
        self._at = at
        self._start = start
        self._end = ""  # why there is no further round

    def first(self) -> Sequence[Point]:
        """The grid under the seeds of the first round."""
        return self._first

    def outlook(self) -> str:
        """Which rounds may follow."""
        rounds = self.rounds
        if rounds.most == rounds.first:
            return ""
        count = "1 seed" if rounds.step == 1 else f"{rounds.step} seeds"
        hours = f" or {rounds.hours:g} hours of work" if rounds.hours else ""
        return (
            f"This is the first round. Rounds of {count} follow, for levels without a verdict and their baseline, "
            f"up to {rounds.most} seeds{hours}: {self.n_trials} trials at most."
        )

    def consult(self, evidence: Evidence) -> None:
        """Keep it, and say where other looks came before."""
        self._evidence = evidence
        before = evidence.looks_before
        if before and before != self.looks:
            evidence.say(
                f"An earlier start judged this sweep after {listed(before)} seeds; this one does after "
                f"{listed(self.looks)}. The error is spent over all of these; where some are new, the earlier ones had "
                "a larger share of it, and a false verdict is somewhat likelier than 5 %."
            )

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        """Once a round has ended, judge it, and propose the next."""
        is_running = any(one.state is TrialState.RUNNING for one in standings.values())
        if self._end or is_running:
            return Advice()
        evidence = self._evidence
        cells = _cells(standings)
        found = evidence.verdicts(standings)
        look = self.rounds.after(max(len(cell.seeds) for cell in cells.values()))
        asked = self._lacking(cells, _wanted(found), look)
        points = [self._at(cells[place].overrides, seed) for place, seed in asked]
        work = evidence.work(standings, points, slots)
        lines = round_text(found, list(cells), self._tell, evidence.margin, self.rounds.most)
        evidence.say(f"{lines}\n{self._so_far(found, cells, work)}")
        self._end = self._why_to_end(_wanted(found), look, work)
        evidence.say(self._end or self._announce(asked, work, slots))
        return Advice() if self._end else Advice(points)

    def _tell(self, level: str) -> str:
        return level_text(self._evidence.factor, level)

    def _lacking(
        self, cells: Mapping[Place, Cell], wanted: Sequence[Place], look: int | None
    ) -> list[tuple[Place, int]]:
        """Places that get further seeds until a look, each with a seed that it lacks."""
        seeds = range(self._start, self._start + (look or 0))
        ordered = [place for place in cells if place in wanted]
        return [(one, seed) for one in ordered for seed in seeds if seed not in cells[one].seeds]

    def _so_far(self, found: pd.DataFrame, cells: Mapping[Place, Cell], work: Work) -> str:
        seeds = max(len(cell.seeds) for cell in cells.values())
        spent = time_text(work.done)
        return f"After {seeds} seeds and {spent} of work {decided(found, cells)}."

    def _why_to_end(self, wanted: Sequence[Place], look: int | None, work: Work) -> str:
        """Why there is no further round; empty: there is one."""
        if not wanted:
            return "No level is open: the sweep has ended."
        if look is None:
            return (
                f"Levels are open, and {self.rounds.most} seeds are the most that were asked for; with a larger "
                "hydra.sweeper.most the sweep goes on."
            )
        hours = self.rounds.hours
        if hours is not None and work.left > 0 and work.done + work.left > hours * HOUR:
            return (
                f"Levels are open, and the next round would take {time_text(work.left)} of work, past "
                f"hours={hours:g}; with larger hydra.sweeper.hours the sweep goes on."
            )
        return ""

    def _announce(self, asked: Sequence[tuple[Place, int]], work: Work, slots: int) -> str:
        """What the next round is, and what it costs."""
        places = {place for place, _ in asked}
        seeds = sorted({seed for _, seed in asked})
        named = f"seed{'s' if len(seeds) > 1 else ''} {listed(seeds)}"
        n_groups = len({group for group, _ in places})
        base = "the baseline" if n_groups == 1 else f"{n_groups} baselines"
        levels = len(places) - n_groups
        cost = "trained already"
        if work.left > 0:
            wait = f"{time_text(work.wait)} on {slots} at once"
            cost = f"{time_text(work.left)} of work, {wait}"
        return f"Next: {named} of {levels} level{'s' if levels > 1 else ''} and {base}: {cost}."

    def report(self, standings: Mapping[str, Standing], folder: Path) -> str:
        """How the sweep ended; the tables say what it has found."""
        found = self._evidence.verdicts(standings)
        work = self._evidence.work(standings, (), 1)
        return f"\n**Until decided**: {self._so_far(found, _cells(standings), work)} {self._end}"


def _cells(standings: Mapping[str, Standing]) -> dict[Place, Cell]:
    """What was proposed of each group and level, in the grid's order."""
    cells: dict[Place, Cell] = {}
    for one in standings.values():
        trial = one.trial
        cell = cells.setdefault((trial.group, trial.level), Cell(trial.overrides[:-1]))
        cell.seeds.add(trial.seed)
    return cells


def _wanted(found: pd.DataFrame) -> list[Place]:
    """Levels that are open, and the baselines of their groups."""
    if found.empty:
        return []
    places: list[Place] = []
    for group, own in found.groupby("group"):
        is_open = own["open"].astype(bool)
        if is_open.any():
            kept = own[is_open | (own["verdict"] == Verdict.BASELINE)]
            places += [(str(group), str(level)) for level in kept["level"]]
    return places


def until_decided(
    params: Mapping[str, object],
    arguments: Sequence[str],
    compose: Compose,
    settings: Mapping[str, object],
) -> UntilDecided:
    """The sweeper of a sweep file and the command line.

    Args:
        params: see ``grid.expand``.
        arguments: see ``grid.expand``.
        compose: makes a config of overrides.
        settings: see ``rounds.Rounds``.

    Raises:
        ConfigError: seeds are swept, a value that cannot be listed, or counts that do not go together.
    """
    rounds = rounds_of(settings)
    laid = expand(params, arguments)
    grid = laid.points
    if any(SEED in values_by_key(point) for point in grid):
        raise ConfigError(
            "seed: hydra/sweeper=until_decided adds the seeds itself. Leave seed= and seeds= out (or give the first, "
            "seed=5) and say hydra.sweeper.first=3 hydra.sweeper.most=10; for a grid of seeds leave the sweeper out"
        )

    def at(overrides: Sequence[str], seed: int) -> Point:
        seeded = [*overrides, f"{SEED}={seed}"]
        return point_of(seeded, compose([*laid.whole(overrides), seeded[-1]]))

    start = compose(laid.whole(grid[0]))[SEED]
    return UntilDecided(grid, at, start, rounds)
