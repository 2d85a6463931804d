"""How often the intervals that fl3d prints hold the truth, over made-up validation sets whose truth is known.

    python benchmarks/interval_coverage.py            # ten minutes on one core
    python benchmarks/interval_coverage.py --quick    # one minute, ten times fewer sets
    python benchmarks/interval_coverage.py --seeds 3 5 10

The sets are those of ``validation_sets.py``; APs, resamples and intervals are fl3d's own. fl3d takes 10,000 resamples,
here 500 do: that makes an interval a little narrower or wider by chance, and hardly changes how often it holds. Only
the far ends of a family's percentiles need more: 4000 where they decide alone, over one seed.
(The file cannot be called coverage.py: numba, imported by a script beside it, would take it for the package.)
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parent.parent))

from benchmarks.told import tell
from benchmarks.validation_sets import (
    EASY,
    HARD,
    LOCATED,
    MODERATE,
    R40,
    Float,
    Scene,
    World,
    detect,
    draw_level,
    draw_scene,
    draws_of,
    independent,
    match,
    truth,
    value_of,
)
from fl3d.analysis.samples import Measured, pair_seeds
from fl3d.evaluation.bootstrap import widened
from fl3d.evaluation.intervals import Interval, Sample, interval, joint_intervals

RESAMPLES = 500
OF_ONE_SEED = 4000
AVERAGES = ("R11", "R40")
CELLS = [(metric, hardest) for metric in LOCATED for hardest in (EASY, MODERATE, HARD)]


@dataclass(frozen=True)
class Row:
    """A case of the table over seeds.

    Args:
        world: of the validation sets.
        ap: of both levels, mean over seeds.
        own: s.d. over seeds of each level by itself, AP.
        shared: s.d. over seeds of both levels together: of what trials inherit from a common warm-up.
    """

    world: World
    ap: float = 77.0
    own: float = 3.0
    shared: float = 0.0

    def __str__(self) -> str:
        front = f"{self.world.n_frames} | {self.world.rho:g} | {self.world.lasting:g}"
        return f"{front} | {self.ap:g} | {self.own:g} | {self.shared:g}"


ROWS = (
    Row(independent(100, 0.0)),
    Row(independent(100, 0.99)),
    Row(independent(300, 0.5)),
    Row(independent(300, 0.99)),
    Row(independent(1000, 0.99)),
    Row(independent(300, 0.99), own=0.9, shared=2.8),  # trials that share their warm-up
    Row(independent(300, 0.5, 0.9), own=0.5, shared=2.0),  # levels that see objects otherwise
    Row(independent(300, 0.9), ap=40.0),
)


@dataclass(frozen=True)
class Pair:
    """Baseline and level on one validation set; of each seed what ``pair_seeds`` takes, by average."""

    sides: tuple[Mapping[str, Mapping[int, Measured]], ...]
    true: Float  # (2, S, 2) AP of each side, seed and average on endless frames


def draw_pairs(row: Row, n_seeds: int, n_sets: int) -> Iterator[Pair]:
    """Validation sets, each with so many seeds of two levels."""
    known = truth()
    rng = np.random.default_rng(0)
    for _ in range(n_sets):
        scene = draw_scene(row.world, rng)
        shared = row.shared * rng.standard_normal(n_seeds)
        sides, true = [], []
        for _ in range(2):
            level = draw_level(row.world, scene, rng)
            aps = row.ap + shared + row.own * rng.standard_normal(n_seeds)
            shifts = np.array([known.shift(ap) for ap in aps])
            seeds = [match(scene, detect(row.world, scene, level, one, rng)) for one in shifts]
            values = [value_of(one) for one in seeds]
            draws = [draws_of(one, RESAMPLES) for one in seeds]
            own = {
                name: {s: Measured(values[s][k], draws[s][:, k]) for s in range(n_seeds)}
                for k, name in enumerate(AVERAGES)
            }
            sides.append(own)
            true.append(known.ap(shifts))
        yield Pair(tuple(sides), np.array(true))


def holds(one: Interval, value: float) -> bool:
    """Whether an interval holds a value."""
    return one.low <= value <= one.high


def coverage(row: Row, seeds: Sequence[int], n_sets: int) -> dict[tuple[str, str, int], Float]:
    """How often each interval held, and its median width: (2,) by what, average and number of seeds.

    The truth of one seed is that seed's own; of several the mean over all seeds that there could be.
    """
    mean = truth().mean(row.ap, float(np.hypot(row.own, row.shared)))
    found: dict[tuple[str, str, int], list[tuple[float, float]]] = {}
    for pair in draw_pairs(row, max(seeds), n_sets):
        for k, name in enumerate(AVERAGES):
            base, side = (own[name] for own in pair.sides)
            for n in seeds:
                ap, gain = pair_seeds({s: side[s] for s in range(n)}, base)
                true = pair.true[:, 0, k] if n == 1 else np.array([mean[k], mean[k]])
                before = two_levels([side[s][1] for s in range(n)], [base[s][1] for s in range(n)])
                told = (
                    ("AP", interval(ap), true[1]),
                    ("gain", interval(gain), true[1] - true[0]),
                    ("two levels", before, true[1] - true[0]),
                )
                for what, one, value in told:
                    held = (holds(one, value), one.high - one.low)
                    found.setdefault((what, name, n), []).append(held)
    return {
        key: np.array([100 * np.mean([h for h, _ in own]), np.median([w for _, w in own])])
        for key, own in found.items()
    }


def two_levels(side: Sequence[Float], base: Sequence[Float]) -> Interval:
    """What one would pick instead, and fl3d did: frames and seeds are drawn again together."""
    gains = np.array(side) - np.array(base)
    n, n_resamples = gains.shape
    chosen = np.random.default_rng(1).integers(n, size=(n, n_resamples))
    draws = np.take_along_axis(gains, chosen, axis=0).mean(axis=0)
    low, high = np.percentile(draws, [2.5, 97.5])
    return Interval(float(draws.mean()), float(low), float(high))


def seeds_table(rows: Sequence[Row], seeds: Sequence[int], n_sets: int) -> list[float]:
    """Coverage of gains and APs over seeds; the lowest and the highest of gains, two seeds aside."""
    counts = " / ".join(str(n) for n in seeds)
    print(f"\nCoverage of nominal 95 %, {counts} seeds; {n_sets} sets a row{error(n_sets)}\n")
    heads = ["gain R11", "gain R40", "median width of the gain in R40", "AP R11", "AP R40"]
    heads.append("frames and seeds drawn together: gain R40")
    print("| frames | ρ | lasting | AP | own s.d. | shared s.d. | " + " | ".join(heads) + " |")
    print("|---:" * 6 + "|---" * len(heads) + "|")
    extremes = []
    for row in rows:
        found = coverage(row, seeds, n_sets)
        columns = [("gain", "R11", 0), ("gain", "R40", 0), ("gain", "R40", 1)]
        columns += [("AP", "R11", 0), ("AP", "R40", 0), ("two levels", "R40", 0)]
        cells = [
            " / ".join(f"{found[what, name, n][place]:.{place}f}" for n in seeds)
            for what, name, place in columns
        ]
        print(f"| {row} | {' | '.join(cells)} |", flush=True)
        extremes += [found["gain", name, n][0] for name in AVERAGES for n in seeds if n != 2]
    told_seeds = ", ".join(str(n) for n in seeds if n != 2)
    print(f"\nGains of {told_seeds} seeds: {min(extremes):.1f} to {max(extremes):.1f} %.")
    return [min(extremes), max(extremes)]


def error(n_sets: int) -> str:
    """Monte-Carlo error of a share, percent."""
    near, far = (100 * np.sqrt(p * (1 - p) / n_sets) for p in (0.95, 0.85))
    return f" (Monte-Carlo error ± {near:.1f} at 95 %, ± {far:.1f} at 85 %)"


def family_table(n_sets: int) -> dict[str, float]:
    """How often any of a family of intervals, taken together, misses zero where nothing gains anything."""
    missed = {}
    print("\nNull sweeps of six levels with any gain in R40 that differs from zero, %")
    print(
        "(100 frames, ρ = 0.9; one seed: over frames only, and all seeds alike; else own s.d. 3)\n"
    )
    print("| family | seeds | sweeps | all at once | each by itself |")
    print("|---|---:|---:|---:|---:|")
    for cells in (CELLS[4:5], CELLS):
        of = n_sets if len(cells) == 1 else n_sets // 3
        for n_seeds, own in ((1, 0.0), (3, 3.0), (5, 3.0)):
            found = [null_sweep(number, cells, n_seeds, own) for number in range(of)]
            name = "6 levels, one metric" if len(cells) == 1 else "36 cells of a table"
            shares = [share([bool(one[k]) for one in found]) for k in (0, 1)]
            print(f"| {name} | {n_seeds} | {of} | {shares[0]} | {shares[1]} |", flush=True)
            missed[f"{name}, {n_seeds} seeds"] = 100 * float(np.mean([one[0] for one in found]))
    return missed


def null_sweep(
    number: int, cells: Sequence[tuple[str, int]], n_seeds: int, own: float
) -> tuple[bool, bool]:
    """Whether any gain is told from zero, all looked at together and each by itself."""
    rng = np.random.default_rng([2, number])
    world = independent(100, 0.9)
    scene = draw_scene(world, rng)
    levels = [draw_replicates(world, scene, cells, n_seeds, own, rng) for _ in range(7)]
    family: list[Sample] = []
    for side in levels[1:]:
        family += [pair_seeds(a, b)[1] for a, b in zip(side, levels[0], strict=True)]
    together = any(one.excludes_zero for one in joint_intervals(family))
    return together, any(interval(one).excludes_zero for one in family)


def draw_replicates(
    world: World,
    scene: Scene,
    cells: Sequence[tuple[str, int]],
    n_seeds: int,
    own: float,
    rng: np.random.Generator,
) -> list[dict[int, Measured]]:
    """R40 of a level's seeds, for each cell."""
    level = draw_level(world, scene, rng)
    found: list[dict[int, Measured]] = [{} for _ in cells]
    n_resamples = OF_ONE_SEED if n_seeds == 1 else RESAMPLES
    for seed in range(n_seeds):
        shift = truth().shift(77.0 + own * rng.standard_normal())
        detections = detect(world, scene, level, shift, rng)
        for place, (metric, hardest) in enumerate(cells):
            one = match(scene, detections, metric, hardest)
            found[place][seed] = Measured(
                float(value_of(one)[R40]), draws_of(one, n_resamples)[:, R40]
            )
    return found


def share(hits: Sequence[bool]) -> str:
    """Percent, with its Monte-Carlo error."""
    n = len(hits)
    mean = float(np.mean(hits))
    told = max(mean, 1 / n)
    return f"{100 * mean:.1f} ± {100 * np.sqrt(told * (1 - told) / n):.1f}"


def sizes(n_drives: int, n_frames: int, ratio: float = 1.0) -> tuple[int, ...]:
    """Drives of which each has so much fewer frames than the one before."""
    parts = ratio ** np.arange(n_drives)
    return tuple(int(part) for part in np.maximum(1, np.round(n_frames * parts / parts.sum())))


STRONG = {"rho": 0.9, "drive": 0.4, "own_drive": 0.3}
# KITTI's val split: 45 drives of 577 frames to one, which tell as much as 14 equal ones; so do these.
DRIVES = {
    "3 alike": sizes(3, 300),
    "5 alike": sizes(5, 300),
    "7 alike": sizes(7, 300),
    "10 alike": sizes(10, 300),
    "20 alike": sizes(20, 300),
    "40 alike": sizes(40, 300),
    "5 unequal": sizes(5, 300, 0.7),
    "10 unequal": sizes(10, 300, 0.8),
    "20 unequal": sizes(20, 600, 0.87),
    "45 as unequal as KITTI's": sizes(45, 900, 0.867),
}


def drives_table(n_sets: int) -> dict[str, float]:
    """Coverage where frames of a drive are alike, by what is resampled; that of widened gains in R40, by drives."""
    held = {}
    print(
        f"\nFrames of drives, one seed; coverage of nominal 95 %, R11 / R40; {n_sets} sets a row"
        f"{error(n_sets)}.\nWidened, as drives are few: what fl3d prints\n"
    )
    print("| drives | frames | worth of equal drives | AP: frames | drives | widened |", end="")
    print(" gain: frames | drives | widened |")
    print("|---|---:|---:|---|---|---|---|---|---|")
    for name, frames in DRIVES.items():
        world = World(frames, **STRONG)
        found = drive_coverage(world, n_sets)
        counts = np.array(frames)
        front = f"{name} | {counts.sum()} | {counts.sum() ** 2 / (counts**2).sum():.0f}"
        cells = [
            " / ".join(f"{found[what, name, way]:.0f}" for name in AVERAGES)
            for what in ("AP", "gain")
            for way in ("frames", "drives", "widened")
        ]
        print(f"| {front} | {' | '.join(cells)} |", flush=True)
        held[name] = found["gain", "R40", "widened"]
    return held


def drive_coverage(world: World, n_sets: int) -> dict[tuple[str, str, str], float]:
    """How often intervals of an AP and of a gain held, by average and by what is resampled."""
    known = truth(world.drive, world.own_drive)
    shift = known.shift(77.0)
    true = known.ap(shift)
    rng = np.random.default_rng(3)
    found: dict[tuple[str, str, str], list[bool]] = {}
    for _ in range(n_sets):
        scene = draw_scene(world, rng)
        pair = [
            match(scene, detect(world, scene, draw_level(world, scene, rng), shift, rng))
            for _ in range(2)
        ]
        for way, draws in drive_draws(pair, world.units).items():
            for k, name in enumerate(AVERAGES):
                low, high = np.percentile(draws[0][:, k], [2.5, 97.5])
                found.setdefault(("AP", name, way), []).append(low <= true[k] <= high)
                low, high = np.percentile(draws[1][:, k] - draws[0][:, k], [2.5, 97.5])
                found.setdefault(("gain", name, way), []).append(low <= 0 <= high)
    return {key: 100 * float(np.mean(held)) for key, held in found.items()}


def drive_draws(pair: Sequence, units: NDArray[np.int64]) -> dict[str, list[Float]]:
    """(R, 2) of each of some matches, by what is resampled."""
    drives = [draws_of(one, RESAMPLES, units) for one in pair]
    return {
        "frames": [draws_of(one, RESAMPLES) for one in pair],
        "drives": drives,
        "widened": [widened(draws, units) for draws in drives],
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer sets")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 5])
    parser.add_argument("--only", choices=["seeds", "families", "drives"], help="one of the tables")
    given = parser.parse_args()
    began = time.process_time()
    found: dict[str, object] = {}
    if given.only in (None, "seeds"):
        found["gains held %, lowest and highest"] = seeds_table(
            ROWS, sorted(given.seeds), 50 if given.quick else 500
        )
    if given.only in (None, "families"):
        found["null families %"] = family_table(30 if given.quick else 300)
    if given.only in (None, "drives"):
        found["drives, widened, gain R40 held %"] = drives_table(50 if given.quick else 500)
    print(f"\n{RESAMPLES} resamples; {time.process_time() - began:.0f} CPU seconds.")
    tell("interval_coverage", found)


if __name__ == "__main__":
    main()
