"""A sweep small enough for a test: six frames, two steps an epoch."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fl3d.config import compose_config
from fl3d.pipeline import Sweep
from fl3d.records import StagePaths
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.sweepers.base import Point
from fl3d.sweep.sweepers.grid import Listed

SMALL = (
    "profile=tiny",
    "data.generate=false",
    "data.cache_frames=10",
    "schedule.frames_per_epoch=4",
    "schedule.stages.warmup.epochs=2",
    "schedule.stages.focal.epochs=2",
)


def small_config(simulated: Path, root: Path, *overrides: str) -> dict[str, Any]:
    """A resolved config over the simulated fixture, with its store below ``root``."""
    places = [f"data.root={simulated}", f"store.root={root / 'runs'}", f"results={root / 'results'}"]
    return compose_config([*SMALL, *places, *overrides])


def small_sweep(simulated: Path, root: Path, points: Sequence[Sequence[str]], *common: str) -> Sweep:
    """A sweep over points, each a list of overrides."""
    listed = [Point(tuple(point), small_config(simulated, root, *common, *point)) for point in points]
    return Sweep(Listed(listed), say=lambda line: None)


def train(simulated: Path, root: Path, *points: Sequence[str]) -> tuple[Plan, Path]:
    """Train the stages of a small sweep in this process, without a store: its plan and the folder of its stages."""
    sweep = small_sweep(simulated, root, points)
    sweep.scheduler(InlineLauncher()).run().check()
    return sweep.plan, sweep.stages_root


def last_weights(stages_root: Path, key: str) -> bytes:
    """Bytes of a stage's last checkpoint."""
    paths = StagePaths(stages_root / key)
    return paths.weights(paths.steps()[-1]).read_bytes()


__all__ = ["SMALL", "last_weights", "small_config", "small_sweep", "train"]
