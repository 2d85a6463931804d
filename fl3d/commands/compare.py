"""``compare``: anybody's detectors, by their result files."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from pathlib import Path

from fl3d.analysis import MARGIN
from fl3d.commands.parsing import parser, protocol_names
from fl3d.core.errors import ConfigError, Fl3dError
from fl3d.core.loading import loading
from fl3d.evaluation import MISSING

FAILED = 2  # exit code of a mistake, as argparse has it
DESCRIPTION = """\
Say whether a detector is better than another, by KITTI result files (one NNNNNN.txt a frame) that any code wrote.

It prints the AP of each by KITTI's official rules, its gain over the baseline with intervals that hold for all
detectors at once, and, from three runs of training on, a verdict: better, worse, equivalent within a margin, or
undecided and about how many more runs would tell. One run of each says nothing about another training: no verdict.
All folders must be of the same frames; results are taken as they are, neither cut nor suppressed.
"""
EXAMPLES = """\
examples:
  python -m fl3d compare training/label_2 theirs=results/theirs mine=results/mine
  python -m fl3d compare training/label_2 theirs=t0,t1,t2 mine=m0,m1,m2 --classes Car --out comparison

The second compares three runs of each, which is what a verdict needs, and writes tables for a paper and a page:
comparison/compare.html. Frames of one drive are much alike: where the folder `mapping` of KITTI's development kit lies
beside `training`, or --mapping names it, drives are resampled instead of frames.
"""


def run(arguments: list[str]) -> None:
    """Compare detectors by folders of KITTI result files, whoever wrote them."""
    try:
        _compare(arguments)
    except Fl3dError as error:
        print(f"fl3d: {error}", file=sys.stderr)
        sys.exit(FAILED)


def _compare(arguments: list[str]) -> None:
    given = _parser().parse_intermixed_args(arguments)
    with loading():
        from fl3d.analysis.compare_tables import text_of
        from fl3d.analysis.detectors import read_detectors
        from fl3d.api.comparison import compare

    if given.out is None and (given.clouds or given.pictures):
        raise ConfigError(
            "--clouds and --pictures are for the page: name a folder for it with --out"
        )
    compared = compare(
        given.labels,
        read_detectors(given.detectors),
        baseline=given.baseline,
        classes=_listed(given.classes),
        protocol=given.protocol,
        overlaps=_overlaps(given.overlaps),
        split=given.split,
        missing=given.missing,
        mapping=given.mapping,
        margin=given.margin,
        clouds=given.clouds,
        calib=given.calib,
        pictures=given.pictures,
        out=given.out,
        made_by=shlex.join(["python", "-m", "fl3d", "compare", *arguments]),
        warn=lambda line: print(f"fl3d: warning: {line}", file=sys.stderr),
    )
    held = compared.held
    protocol = f"protocol {held.protocol.name} (variant {held.protocol.variant})"
    print(f"{len(held.ids)} frames, {protocol}; AP in percent\n")
    print(text_of(compared))
    if given.out is not None:
        print(f"\nWritten to {given.out / 'compare.html'}, with tables and figures beside it.")


def _parser() -> argparse.ArgumentParser:
    options = parser("compare", DESCRIPTION)
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.epilog = EXAMPLES
    options.add_argument(
        "labels",
        type=Path,
        metavar="LABELS",
        help="folder of label files, such as training/label_2",
    )
    options.add_argument(
        "detectors",
        nargs="+",
        metavar="NAME=FOLDER",
        help="a detector's result files; NAME=RUN1,RUN2,RUN3: of several runs; FOLDER alone has its own name",
    )
    options.add_argument(
        "--baseline", metavar="NAME", help="that the others are held against (default: the first)"
    )
    options.add_argument(
        "--classes", default="", metavar="A,B", help="default: those that two of them detect"
    )
    options.add_argument(
        "--split",
        type=Path,
        metavar="FILE",
        help="frames to compare on, a name a line (default: all)",
    )
    options.add_argument(
        "--missing",
        choices=("error", *MISSING),
        default="error",
        help="a frame that a folder has no file of",
    )
    options.add_argument(
        "--protocol",
        default="kitti",
        choices=protocol_names(),
        help="overlaps and variant (default: kitti)",
    )
    options.add_argument(
        "--overlaps",
        action="append",
        default=[],
        metavar="NAME=IMAGE,BEV,3D",
        help="overlaps of a class, such as one of your own: Cone=0.5,0.25,0.25 (may be given again)",
    )
    options.add_argument(
        "--margin", type=_margin, default=MARGIN, metavar="AP", help="gains below it do not matter"
    )
    options.add_argument(
        "--mapping", type=Path, metavar="FOLDER", help="KITTI's mapping of frames to drives"
    )
    options.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="for tables (Markdown, LaTeX, CSV), figures, a page",
    )
    options.add_argument(
        "--clouds",
        type=Path,
        metavar="FOLDER",
        help="velodyne: points on objects, frames with clouds",
    )
    options.add_argument(
        "--calib", type=Path, metavar="FOLDER", help="of the clouds (default: calib beside LABELS)"
    )
    options.add_argument(
        "--pictures", type=Path, metavar="FOLDER", help="image_2: frames with pictures"
    )
    return options


def _overlaps(words: list[str]) -> dict[str, tuple[float, float, float]]:
    """Overlaps by class, of ``Cone=0.5,0.25,0.25``."""
    added: dict[str, tuple[float, float, float]] = {}
    for word in words:
        class_name, _, numbers = word.partition("=")
        try:
            image, bev, space = (float(number) for number in numbers.split(","))
        except ValueError:
            raise ConfigError(
                f"--overlaps {word}: not NAME=IMAGE,BEV,3D, such as Cone=0.5,0.25,0.25"
            ) from None
        added[class_name] = (image, bev, space)
    return added


def _margin(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of AP above 0")
    return value


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]
