"""A KITTI folder of the simulator's."""

from __future__ import annotations

from pathlib import Path

from fl3d.core.errors import ConfigError
from fl3d.simulator import MOST_PEOPLE
from fl3d.simulator.generate import Settings, write_folder

FRAMES = 700


def simulate(
    out: Path | str,
    frames: int = FRAMES,
    *,
    val: int | None = None,
    seed: int = 0,
    pictures: bool = True,
    whole_turn: bool = False,
    people: float | None = None,
    workers: int | None = None,
) -> Path:
    """Write a simulated KITTI folder: ``fl3d simulate``.

    It holds velodyne, label_2, calib, image_2, ImageSets and 2D detections. Same numbers and seed, same bytes, whatever
    the number of workers. Interrupted, the same call resumes.

    Args:
        out: the folder; ``training/`` and ``ImageSets/`` come into it.
        frames: all of them.
        val: of them in the validation split; None: 3 of 7.
        seed: of all randomness.
        pictures: whether ``image_2`` is written; without, it is six times faster.
        whole_turn: clouds all around, not only what the camera sees.
        people: pedestrians and cyclists as in KITTI, so many times as often, up to 3; None: the streets of
            ``data=simulated``, which have some.
        workers: processes; None: one a core.

    Returns:
        the folder.

    Raises:
        ConfigError: a number that cannot be, or a folder that holds other frames.
    """
    in_val = frames * 3 // 7 if val is None else val
    if frames < 1 or not 0 <= in_val <= frames:
        raise ConfigError(f"val: {in_val} of {frames} frames; it is at least 0 and at most all")
    if seed < 0 or (workers is not None and workers < 1):
        raise ConfigError("seed is a whole number of at least 0, workers one of at least 1")
    if people is not None and not 0 < people <= MOST_PEOPLE:
        raise ConfigError(f"people: {people} is not a number above 0 and at most {MOST_PEOPLE:g}")
    settings = Settings(
        train=frames - in_val,
        val=in_val,
        seed=seed,
        pictures=pictures,
        whole_turn=whole_turn,
        people=people,
    )
    write_folder(Path(out), settings, workers)
    return Path(out)
