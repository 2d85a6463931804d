"""How often a sweep that adds seeds until it has verdicts is wrong, and how many seeds it takes.

Whole sweeps are simulated and judged by fl3d itself: by the sweeper ``until_decided``, and by ``resampled_aps`` over
the ``Matches`` of synthetic validation sets. A set has 300 frames, 2.6 cars a frame (negative-binomial) and 5 pieces of
clutter. A score is made of effects of the frame, of the object (shared by all detectors: rho), of the level (in all of
its seeds: a share of the rest, "lasting") and of the replicate. Seeds also move a level's true AP: "s.d." is that of a
gain between seeds, on endless frames. A sweep has a baseline and six levels.

    python benchmarks/verdicts.py            # ten minutes on one core
    python benchmarks/verdicts.py --sets 5
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.told import tell
from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import CELLS, Resampled, paired
from fl3d.analysis.verdicts import verdicts
from fl3d.config.settings import SweepSettings
from fl3d.core.records import Trial
from fl3d.evaluation import intervals
from fl3d.evaluation.bootstrap import resampled_aps, unit_weights
from fl3d.evaluation.intervals import (
    ALPHA,
    Sample,
    frames_alpha,
    half_width,
    interval,
    joint_intervals,
    member_alpha,
)
from fl3d.evaluation.matching import Matches, sort_matches
from fl3d.sweep.sweepers.base import Evidence, Point, Standing, TrialState, Work
from fl3d.sweep.sweepers.rounds import Rounds
from fl3d.sweep.sweepers.until_decided import UntilDecided

FRAMES = 300
LEVELS = 6
SEEDS = 10
RESAMPLES = 200  # fl3d itself takes 10,000
CARS, SHAPE, CLUTTER = 2.6, 2.0, 5.0
FRAME_EFFECT = 0.6  # of a score, beside 1 of the objects
MISSED = -1.3  # of a standard normal: a twelfth of the cars is located too badly to count
CARS_SCORE = 2.9  # by how much a car's score lies above clutter's: AP 77
CELL = CELLS.index(("3d", "moderate"))
R40 = AVERAGES.index("R40")
ASKED = SweepSettings(
    name="simulated",
    question=None,
    factor=("x",),
    baseline=None,
    groups=None,
    primary="3d_r40/moderate",
    margin=1.0,
    tables=(),
    after=None,
    winner=None,
)
Float = NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """How detectors resemble each other.

    Args:
        rho: correlation of two detectors' noise on an object.
        lasting: share of the rest that a level has in all of its seeds.
        spread: s.d. of a gain between seeds, AP.
    """

    rho: float
    lasting: float
    spread: float

    def __str__(self) -> str:
        return f"{self.spread:g} | {self.rho:g} | {self.lasting:g}"


@dataclass(frozen=True)
class Scene:
    """A validation set: the frame of each car and each piece of clutter, and what all detectors share of them."""

    n_gt: NDArray[np.int64]
    frames: NDArray[np.int64]  # of the cars, then of the clutter
    is_car: NDArray[np.bool_]
    score: Float
    located: Float
    effect: Float  # of each object's frame


def draw_scene(rng: np.random.Generator, n_frames: int) -> Scene:
    n_gt = rng.negative_binomial(SHAPE, SHAPE / (SHAPE + CARS), n_frames)
    n_clutter = rng.poisson(CLUTTER, n_frames)
    places = np.arange(n_frames)
    frames = np.concatenate([np.repeat(places, n_gt), np.repeat(places, n_clutter)])
    is_car = np.arange(len(frames)) < n_gt.sum()
    effect = rng.normal(0, FRAME_EFFECT, n_frames)[frames]
    return Scene(n_gt, frames, is_car, *rng.standard_normal((2, len(frames))), effect)


def matches(
    scene: Scene, rng: np.random.Generator, world: World, own: Float, shift: float
) -> Matches:
    """A replicate's detections, held against the labels.

    Args:
        scene: the validation set.
        rng: of what is the replicate's own.
        world: how detectors resemble each other.
        own: (2, D) what its level has in all its seeds.
        shift: by how much it scores cars higher.
    """
    each = rng.standard_normal((2, len(scene.frames)))
    rest = np.sqrt(world.lasting) * own + np.sqrt(1 - world.lasting) * each
    common = np.stack([scene.score, scene.located])
    score, located = np.sqrt(world.rho) * common + np.sqrt(1 - world.rho) * rest
    score = score + scene.effect + scene.is_car * (CARS_SCORE + shift)
    is_hit = scene.is_car & (located > MISSED)
    hits = (score[is_hit], scene.frames[is_hit])
    tp = is_hit.astype(np.int64)
    events = (score, scene.frames, tp, 1 - tp, np.zeros(len(score)))
    return sort_matches(scene.n_gt, hits, events)


@lru_cache
def curve() -> tuple[Float, Float]:
    """Shifts, and the true AP under each."""
    shifts = np.linspace(-2, 3, 26)
    rng = np.random.default_rng(1)
    scene = draw_scene(rng, 8_000)
    world = World(0.0, 0.0, 0.0)
    nothing = np.zeros((2, len(scene.frames)))
    one = np.ones((1, len(scene.n_gt)), dtype=np.int32)
    aps = []
    for shift in shifts:
        same = np.random.default_rng(2)
        aps.append(resampled_aps(matches(scene, same, world, nothing, shift), one)[0, R40])
    return shifts, np.array(aps)


def shift_for(ap: float) -> float:
    shifts, aps = curve()
    return float(np.interp(ap, aps, shifts))


def true_ap() -> float:
    shifts, aps = curve()
    return float(np.interp(0.0, shifts, aps))


def draw_sweep(
    rng: np.random.Generator, world: World, gains: Sequence[float]
) -> list[list[Resampled]]:
    """APs of the baseline and the levels, each with all seeds that there can be."""
    scene = draw_scene(rng, FRAMES)
    weights = unit_weights(FRAMES, RESAMPLES)
    found = []
    for gain in (0.0, *gains):
        own = rng.standard_normal((2, len(scene.frames)))
        # Level and baseline each have half of the gain's variance.
        by_seed = gain + rng.normal(0, world.spread / np.sqrt(2), SEEDS)
        aps = []
        for moved in by_seed:
            m = matches(scene, rng, world, own, shift_for(true_ap() + moved))
            aps.append(_resampled(m, weights))
        found.append(aps)
    return found


def _resampled(m: Matches, weights: NDArray[np.int32]) -> Resampled:
    value = resampled_aps(m, np.ones((1, FRAMES), dtype=np.int32))[0, R40]
    draws = resampled_aps(m, weights)[:, R40]
    shape = (len(CELLS), len(AVERAGES))  # every cell shows the one that is judged
    return Resampled(
        np.broadcast_to(value, shape), np.broadcast_to(draws[:, None, None], (len(draws), *shape))
    )


def judged(
    aps: list[list[Resampled]], seeds: Mapping[int, int], looks: tuple[int, ...]
) -> pd.DataFrame:
    """Verdicts, where each level has so many seeds."""
    samples = {str(n): dict(enumerate(aps[n][:count])) for n, count in seeds.items()}
    return verdicts({"all": samples}, "0", ASKED, looks)


class Simulated(Evidence):
    """Evidence of a simulated sweep; without words."""

    factor = ("x",)
    margin = ASKED.margin
    looks_before = ()

    def __init__(self, aps: list[list[Resampled]], looks: tuple[int, ...]) -> None:
        self.aps, self.looks = aps, looks

    def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
        """Of the seeds that were proposed."""
        seeds: dict[int, int] = {}
        for one in standings.values():
            level = int(one.trial.level)
            seeds[level] = max(seeds.get(level, 0), one.trial.seed + 1)
        self.found = judged(self.aps, seeds, self.looks)
        return self.found

    def work(self, standings: object, points: object, slots: int) -> Work:
        """None: all is drawn."""
        return Work(0.0, 0.0, 0.0)

    def say(self, text: str) -> None:
        """Nobody listens."""


def until_decided(aps: list[list[Resampled]]) -> pd.DataFrame:
    """Run the sweeper to its end; its last verdicts."""

    def at(overrides: Sequence[str], seed: int) -> Point:
        return Point((*overrides, f"seed={seed}"), {"x": int(overrides[0][2:]), "seed": seed}, {})

    sweeper = UntilDecided([[f"x={n}"] for n in range(len(aps))], at, 0, Rounds(most=SEEDS))
    evidence = Simulated(aps, sweeper.looks)
    sweeper.consult(evidence)
    standings: dict[str, Standing] = {}
    points = sweeper.first()
    while points:
        for point in points:
            trial = trial_of(point)
            standings[trial.key] = Standing(trial, TrialState.DONE, {}, 1)
        points = sweeper.advise(standings, 1).points
    return evidence.found


def trial_of(point: Point) -> Trial:
    key = " ".join(point.overrides)
    return Trial(
        key=key,
        overrides=point.overrides,
        values=point.values,
        config={},
        stages=(key,),
        first_own_step=0,
        detector="all",
        group="all",
        level=str(point.values["x"]),
        seed=point.values["seed"],
    )


def fixed(aps: list[list[Resampled]], n_seeds: int) -> pd.DataFrame:
    """Verdicts after so many seeds, looked at once."""
    return judged(aps, dict.fromkeys(range(len(aps)), n_seeds), ())


def naive(aps: list[list[Resampled]]) -> bool:
    """Whether any gain differs from zero, if one looks after every seed as though it were the only look."""
    base = dict(enumerate(aps[0]))
    for n_seeds in range(3, SEEDS + 1):
        sides = [dict(enumerate(side[:n_seeds])) for side in aps[1:]]
        family = [paired(side, base, CELL, R40)[1] for side in sides]
        if any(one.excludes_zero for one in joint_intervals(family)):
            return True
    return False


def wider(aps: list[list[Resampled]]) -> bool:
    """Whether any gain of ten seeds differs from zero by the wider of its intervals over frames and over seeds."""
    sides = [dict(enumerate(side)) for side in aps]
    family = [paired(side, sides[0], CELL, R40)[1] for side in sides[1:]]
    frames = frames_alpha(np.stack([one.draws for one in family], axis=1), ALPHA)
    alpha = member_alpha(LEVELS, SEEDS)
    alone = [
        Sample(one.values, one.draws) for one in family
    ]  # as though no frame did the same to all seeds
    return any(interval(one, alpha, frames).excludes_zero for one in alone)


def claims(found: pd.DataFrame) -> bool:
    """Whether any level is called better or worse."""
    return bool(found["verdict"].isin(["better", "worse"]).any())


def deal(
    aps: list[list[Resampled]], world: World, rng: np.random.Generator
) -> list[list[Resampled]]:
    """Another sweep of the same null replicates: to draw them is what takes the time."""
    if world.lasting == 0:  # they are all alike
        every = [one for side in aps for one in side]
        order = rng.permutation(len(every)).reshape(len(aps), -1)
        return [[every[n] for n in row] for row in order]
    return [[aps[level][n] for n in rng.permutation(SEEDS)] for level in rng.permutation(len(aps))]


def share(hits: Sequence[float]) -> str:
    """Percent, with its Monte-Carlo error; of shares of independent sets of replicates."""
    mean, n = float(np.mean(hits)), len(hits)
    error = float(np.std(hits, ddof=1)) / np.sqrt(n) if max(hits) > min(hits) else 1 / n
    return f"{100 * mean:.1f} ± {100 * error:.1f}"


def null_table(worlds: Sequence[World], n_sets: int, deals: int) -> dict[str, list[float]]:
    """False verdicts where no level gains anything: percent of sweeps until decided and of ten seeds, by world."""
    false = {}
    print(
        f"\nNo level gains anything: sweeps with any better or worse, %, of {n_sets * deals} a row "
        f"({n_sets} sets of replicates, dealt out {deals} times):\n"
    )
    heads = [
        "until decided",
        "ten seeds, one look",
        "a look after each seed",
        "ten, the wider alone",
    ]
    print(f"| s.d. | rho | lasting | {' | '.join(heads)} |")
    print("|---:" * 7 + "|")
    for world in worlds:
        rng = np.random.default_rng(0)
        rows = []
        for _ in range(n_sets):
            drawn = draw_sweep(rng, world, [0.0] * LEVELS)
            dealt = [drawn, *(deal(drawn, world, rng) for _ in range(deals - 1))]
            found = [
                (claims(until_decided(aps)), claims(fixed(aps, SEEDS)), naive(aps), wider(aps))
                for aps in dealt
            ]
            rows.append(np.mean(found, axis=0))
        print(
            f"| {world} | {' | '.join(share(one) for one in zip(*rows, strict=True))} |", flush=True
        )
        false[str(world)] = [100 * float(np.mean([row[k] for row in rows])) for k in (0, 1)]
    return false


def normal_rates(n_sweeps: int = 40_000) -> None:
    """False verdicts of the intervals over seeds alone, of many sweeps of normal gains: the frames only widen them."""
    rng = np.random.default_rng(3)
    looks = range(3, SEEDS + 1)
    aps = rng.standard_normal((n_sweeps, LEVELS + 1, SEEDS))
    gains = aps[:, 1:] - aps[:, :1]
    rates = {}
    for name, spent in (("until decided", tuple(looks)), ("a look after each seed", ())):
        is_false = np.zeros(n_sweeps, dtype=bool)
        for n in looks:
            own = gains[:, :, :n]
            t = np.abs(own.mean(axis=2)) / own.std(axis=2, ddof=1) * np.sqrt(n)
            critical = half_width(np.sqrt(n), n, member_alpha(LEVELS, n, spent))
            is_false |= (t > critical).any(axis=1)
        rates[name] = share(is_false)
    told = "; ".join(f"{name} {rate}" for name, rate in rates.items())
    print(f"\nThe same of {n_sweeps} sweeps of normal gains on endless frames, %: {told}.")


def spending_table(n_sweeps: int = 40_000) -> None:
    """What other ways to spend the error would do: normal gains of one level of six, on endless frames."""
    print("\nSeeds (and verdicts, %) by the power of n / N that is spent, of gains in spreads:\n")
    gains = (1, 2, 4)
    print(f"| power | {' | '.join(str(gain) for gain in gains)} | half of the last interval |")
    print("|---:" * 5 + "|")
    looks = tuple(range(3, SEEDS + 1))
    values = np.random.default_rng(5).standard_normal((n_sweeps, SEEDS))
    for power in (1, 2, 3):
        intervals.SPENDING = power
        intervals.spent_alphas.cache_clear()
        halves = [half_width(1.0, n, member_alpha(LEVELS, n, looks)) for n in looks]
        cells = []
        for gain in gains:
            seeds = np.full(n_sweeps, SEEDS)
            is_told = np.zeros(n_sweeps, dtype=bool)
            for n, half in zip(looks, halves, strict=True):
                own = values[:, :n] + gain
                tells = ~is_told & (np.abs(own.mean(axis=1)) > half * own.std(axis=1, ddof=1))
                seeds[tells] = n
                is_told |= tells
            cells.append(f"{seeds.mean():.1f} ({100 * is_told.mean():.0f})")
        print(f"| {power} | {' | '.join(cells)} | {halves[-1]:.2f} |", flush=True)
    intervals.SPENDING = 2
    intervals.spent_alphas.cache_clear()


def margin_table(worlds: Sequence[World], n_sets: int) -> None:
    """False verdicts where each level gains just the margin."""
    print(
        f"\nEach level gains the margin, 1 AP: sweeps with any equivalent or worse, %, of {n_sets}:\n"
    )
    print("| s.d. | rho | lasting | until decided | ten seeds, one look |")
    print("|---:|---:|---:|---:|---:|")
    for world in worlds:
        rng = np.random.default_rng(1)
        rows = []
        for _ in range(n_sets):
            aps = draw_sweep(rng, world, [ASKED.margin] * LEVELS)
            found = (until_decided(aps), fixed(aps, SEEDS))
            rows.append([one["verdict"].isin(["equivalent", "worse"]).any() for one in found])
        print(
            f"| {world} | {' | '.join(share(one) for one in zip(*rows, strict=True))} |", flush=True
        )


GAINS = (0.0, 0.5, 1.0, 2.0, 4.0, 0.0)


def seeds_table(worlds: Sequence[World], n_sets: int) -> None:
    """Seeds that it takes, and verdicts that come, by the true gain."""
    print(
        f"\nSweeps of true gains 0, 0, 0.5, 1, 2, 4; better / worse / equivalent, %, of {n_sets} sweeps:\n"
    )
    print(
        "| s.d. | rho | lasting | gain | mean seeds | given up | until decided | ten seeds | three seeds |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for world in worlds:
        rng = np.random.default_rng(2)
        frames = []
        for _ in range(n_sets):
            aps = draw_sweep(rng, world, GAINS)
            found = {"until": until_decided(aps), "ten": fixed(aps, SEEDS), "three": fixed(aps, 3)}
            for how, one in found.items():
                frames.append(one[one["level"] != "0"].assign(how=how, true=GAINS))
        for gain, own in pd.concat(frames).groupby("true"):
            until = own[own["how"] == "until"]
            given_up = (until["seeds"] < SEEDS) & (until["verdict"] == "undecided")
            texts = [words(own[own["how"] == how]) for how in ("until", "ten", "three")]
            front = f"{until['seeds'].mean():.1f} | {100 * given_up.mean():.0f}"
            print(f"| {world} | {gain:g} | {front} | {' | '.join(texts)} |", flush=True)


def words(own: pd.DataFrame) -> str:
    """How often each verdict came, percent."""
    verdicts_of = own["verdict"]
    return " / ".join(
        f"{100 * (verdicts_of == word).mean():.0f}" for word in ("better", "worse", "equivalent")
    )


# rho 0.99: two detectors' APs have a correlation of 0.95 over resamples, as real levels of gamma have (0.92 to 0.96).
WORLDS = [World(0.99, 0.0, spread) for spread in (0.3, 1.0, 2.0)]
LASTING = [
    World(0.99, 0.5, 0.3),
    World(0.99, 0.5, 1.0),
    World(0.99, 0.9, 0.3),
    World(0.9, 0.5, 1.0),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100, help="of replicates, for each row")
    n_sets = parser.parse_args().sets
    began = time.perf_counter()
    print(f"True AP of the baseline: {true_ap():.1f}. {RESAMPLES} resamples of {FRAMES} frames.")
    false = null_table([*WORLDS, *LASTING], n_sets, deals=4)
    normal_rates()
    spending_table()
    margin_table([WORLDS[0], LASTING[0]], n_sets // 2)
    seeds_table([*WORLDS, *LASTING[:2]], n_sets // 2)
    print(f"\n{time.perf_counter() - began:.0f} s.")
    tell("verdicts", {"false verdicts %: until decided, ten seeds": false})


if __name__ == "__main__":
    main()
