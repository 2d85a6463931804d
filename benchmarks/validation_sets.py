"""Made-up validation sets whose truth is known, for benchmarks and tests of intervals.

A frame has 2.6 cars on average (negative-binomial) and 5 pieces of clutter. A detector scores each object: an effect of
the frame, which all detectors share, cars some shift above clutter, and noise. The noise of two detectors has a
correlation rho on an object; of the rest a level may keep a share in all of its seeds ("lasting"). A car that is
located too badly is a false alarm. Training moves a detector's shift, told as the AP that it has on endless frames.
Frames may come from drives, whose cars are all harder or easier, for every detector and for each by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fl3d.evaluation.bootstrap import resampled_aps, unit_weights
from fl3d.evaluation.matching import Matches, sort_matches

Float = NDArray[np.float64]
Int = NDArray[np.int64]
CARS, SHAPE, CLUTTER = 2.6, 2.0, 5.0
FRAME_EFFECT = 0.5  # s.d., where an object's own noise has 1
LOCATED = {
    "bev": -2.4,
    "3d": -2.0,
}  # of a standard normal: 0.8 % and 2.3 % of the cars are located too badly
CUT = 0.0  # score below which nothing is detected
EASY, MODERATE, HARD = 0, 1, 2
TRUE_FRAMES = 60_000  # of the curve of AP over shift
SHIFTS = np.linspace(0.0, 3.5, 36)  # AP 17 to 94
R11, R40 = 0, 1


@dataclass(frozen=True)
class World:
    """What validation sets are drawn from, and how detectors resemble each other.

    Args:
        drives: frames of each drive.
        rho: correlation of two detectors' noise on an object.
        lasting: share of the rest that all seeds of a level have.
        drive: s.d. over drives of how much harder the cars are, for all detectors.
        own_drive: likewise, for each level by itself.
    """

    drives: tuple[int, ...]
    rho: float = 0.9
    lasting: float = 0.0
    drive: float = 0.0
    own_drive: float = 0.0

    @property
    def n_frames(self) -> int:
        """Of a set."""
        return sum(self.drives)

    @property
    def units(self) -> Int:
        """(F,) the drive of each frame."""
        return np.repeat(np.arange(len(self.drives)), self.drives)


def independent(n_frames: int, rho: float = 0.9, lasting: float = 0.0) -> World:
    """Frames that are each a drive of their own, of no effect."""
    return World((1,) * n_frames, rho, lasting)


@dataclass(frozen=True)
class Scene:
    """A validation set: its objects, cars first, and what all detectors share of them.

    Args:
        n_frames: how many.
        frames: (N,) of each object.
        hardness: (G,) of each car: easy, moderate or hard.
        noise: (2, N) of score and place.
        effect: (N,) of frame and drive on the score.
        drives: (N,) of each object.
    """

    n_frames: int
    frames: Int
    hardness: Int
    noise: Float
    effect: Float
    drives: Int


def draw_scene(world: World, rng: np.random.Generator) -> Scene:
    """One validation set."""
    n = world.n_frames
    n_cars = rng.negative_binomial(SHAPE, SHAPE / (SHAPE + CARS), n)
    n_clutter = rng.poisson(CLUTTER, n)
    frames = np.concatenate([np.repeat(np.arange(n), count) for count in (n_cars, n_clutter)])
    hardness = rng.choice(3, int(n_cars.sum()), p=[0.35, 0.4, 0.25])
    drives = world.units[frames]
    effect = rng.normal(0, FRAME_EFFECT, n)[frames]
    moved = rng.normal(0, 1, len(world.drives)) * world.drive
    effect[: len(hardness)] += moved[drives[: len(hardness)]]
    return Scene(n, frames, hardness, rng.standard_normal((2, len(frames))), effect, drives)


@dataclass(frozen=True)
class Level:
    """What a level has in all of its seeds: (2, N) noise, (N,) effect of the drives."""

    noise: Float
    effect: Float


def draw_level(world: World, scene: Scene, rng: np.random.Generator) -> Level:
    """A level of one validation set."""
    moved = rng.normal(0, 1, len(world.drives)) * world.own_drive
    effect = np.where(np.arange(len(scene.frames)) < len(scene.hardness), moved[scene.drives], 0.0)
    return Level(rng.standard_normal(scene.noise.shape), effect)


def detect(
    world: World, scene: Scene, level: Level, shift: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """A detector's score of each object, and how well it is located: (N,) each."""
    each = rng.standard_normal(scene.noise.shape)
    rest = np.sqrt(world.lasting) * level.noise + np.sqrt(1 - world.lasting) * each
    score, located = np.sqrt(world.rho) * scene.noise + np.sqrt(1 - world.rho) * rest
    score = score + scene.effect + level.effect
    score[: len(scene.hardness)] += shift
    return score, located


def match(
    scene: Scene, detections: tuple[Float, Float], metric: str = "3d", hardest: int = HARD
) -> Matches:
    """Detections held against the labels; cars that are harder are ignored."""
    score, located = detections
    n_gt = len(scene.hardness)
    is_easy = scene.hardness <= hardest
    counts = score > CUT
    counts[:n_gt] &= is_easy
    is_hit = counts & (located > LOCATED[metric])
    is_hit[n_gt:] = False
    tp = is_hit[counts].astype(np.int64)
    events = (score[counts], scene.frames[counts], tp, 1 - tp, np.zeros(len(tp)))
    per_frame = np.bincount(scene.frames[:n_gt][is_easy], minlength=scene.n_frames)
    return sort_matches(per_frame, (score[is_hit], scene.frames[is_hit]), events)


def value_of(matches: Matches) -> Float:
    """(2,) R11 and R40 of the frames as they are."""
    return resampled_aps(matches, np.ones((1, len(matches.n_gt)), dtype=np.int32))[0]


def draws_of(matches: Matches, n_resamples: int, units: Int | None = None) -> Float:
    """(R, 2) in resamples of the frames, or of units."""
    count = len(matches.n_gt) if units is None else int(units.max()) + 1
    return resampled_aps(matches, unit_weights(count, n_resamples), units)


@dataclass(frozen=True)
class Truth:
    """APs on endless frames, by shift: (K, 2)."""

    aps: Float

    def shift(self, ap: float) -> float:
        """The shift that has an R40."""
        return float(np.interp(ap, self.aps[:, R40], SHIFTS))

    def ap(self, shift: float | Float) -> Float:
        """(..., 2) of a shift."""
        return np.stack([np.interp(shift, SHIFTS, self.aps[:, k]) for k in (R11, R40)], axis=-1)

    def mean(self, ap: float, spread: float) -> Float:
        """(2,) mean over training seeds whose R40 has a mean and s.d."""
        aps = ap + spread * np.random.default_rng(0).standard_normal(100_000)
        return self.ap(np.interp(aps, self.aps[:, R40], SHIFTS)).mean(axis=0)


@lru_cache
def truth(drive: float = 0.0, own_drive: float = 0.0) -> Truth:
    """APs over very many frames, four of each drive; neither rho nor what lasts is seen in one detector's."""
    world = World((4,) * (TRUE_FRAMES // 4), 0.0, 0.0, drive, own_drive)
    scene = draw_scene(world, np.random.default_rng(1))
    level = draw_level(world, scene, np.random.default_rng(2))
    aps = [
        value_of(match(scene, detect(world, scene, level, shift, np.random.default_rng(3))))
        for shift in SHIFTS
    ]
    return Truth(np.array(aps))
