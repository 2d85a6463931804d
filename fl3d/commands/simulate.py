"""``simulate``: a KITTI folder of the simulator's."""

from __future__ import annotations

import argparse
from pathlib import Path

from fl3d.commands.parsing import parser
from fl3d.core.loading import loading
from fl3d.simulator import MOST_PEOPLE as MOST


def run(arguments: list[str]) -> None:
    """Write a simulated KITTI folder.

    It holds velodyne, label_2, calib, image_2, ImageSets and 2D detections. Same numbers and seed,
    same bytes, whatever the number of workers. Interrupted, the same command resumes.

    Example: python -m fl3d simulate data/street --frames 1500 --seed 7
    """
    options = parser("simulate", run.__doc__)
    options.add_argument(
        "out",
        type=Path,
        metavar="OUT",
        help="the folder; training/ and ImageSets/ come into it",
    )
    options.add_argument(
        "--frames",
        type=_at_least_one,
        default=700,
        metavar="N",
        help="all of them (default: 700)",
    )
    options.add_argument(
        "--val",
        type=_count,
        metavar="N",
        help="of them in the validation split (default: 3 of 7)",
    )
    options.add_argument(
        "--seed",
        type=_count,
        default=0,
        help="of all randomness (default: 0)",
    )
    options.add_argument(
        "--no-pictures", action="store_true", help="leave image_2 out: six times faster"
    )
    options.add_argument(
        "--whole-turn",
        action="store_true",
        help="clouds all around, not only what the camera sees",
    )
    options.add_argument(
        "--people",
        type=_rate,
        metavar="RATE",
        help=f"pedestrians and cyclists as in KITTI, RATE times as often, up to {MOST:g} "
        "(default: the streets of data=simulated, which have some)",
    )
    options.add_argument(
        "--workers",
        type=_at_least_one,
        metavar="N",
        help="processes (default: one a core)",
    )
    given = options.parse_args(arguments)
    val = given.frames * 3 // 7 if given.val is None else given.val
    if val > given.frames:
        options.error(f"--val {val} is more than --frames {given.frames}")
    with loading():
        from fl3d.api.simulation import simulate

    written = simulate(
        given.out,
        given.frames,
        val=val,
        seed=given.seed,
        pictures=not given.no_pictures,
        whole_turn=given.whole_turn,
        people=given.people,
        workers=given.workers,
    )
    print(written)


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 0")
    return int(text)


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate <= MOST:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number above 0 and at most {MOST:g}")
    return rate


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 1")
    return int(text)
