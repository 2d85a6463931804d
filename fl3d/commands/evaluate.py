"""``evaluate``: KITTI's official numbers of anybody's result files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from fl3d.commands.parsing import parser, protocol_names
from fl3d.core.errors import ConfigError, Fl3dError
from fl3d.core.loading import loading, uncollected
from fl3d.evaluation import MISSING

if TYPE_CHECKING:
    from fl3d.evaluation.folders import Evaluated

NOTHING = 2  # exit code where nothing could be evaluated
EPILOG = """\
what is printed where:
  stdout: the table with the number of ground truths that count (n_gt), then the labels and results
  that do not count and why, as Markdown to be pasted. stderr: warnings of what looks like a mistake
  (angles in degrees, sizes in another order, y in the middle of a box, equal scores; docs/evaluate.md
  has them all). Where nothing could be evaluated, stderr says why, stdout has no table, and the exit
  code is 2.

protocols:
  kitti (today's practice), kitti_loose, paper, paper_strict and report follow KITTI's official
  evaluator: an object counts by its height in the picture, its occlusion and its truncation.
  lidar is fl3d's own, and its numbers cannot be compared with KITTI's: for labels without 2D boxes,
  and for objects all around the sensor. It has no image metric; easy, moderate and hard are objects up
  to 30, 50 and 70 m away, each level holding the one before. Detections further away than a level
  reaches are no false alarms there. Its levels can be changed: 'limits=[20,40,60]', or
  difficulty=none for a single level of all objects.
"""


def run(arguments: list[str]) -> None:
    """Evaluate a folder of KITTI result files (FRAME.txt), whoever wrote them.

    The rules are KITTI's official ones. The results are taken as they are, neither cut nor suppressed.
    An empty result file is a frame in which nothing was found; a frame without one is left out, unless
    --missing says otherwise.
    """
    given = _options().parse_intermixed_args(arguments)
    with uncollected():
        _evaluate(given)


def _evaluate(given: argparse.Namespace) -> None:
    with loading():
        from fl3d.api.evaluation import NothingToCount, evaluate

    why = None
    odd: list[str] = []
    try:
        found = evaluate(
            given.labels,
            given.results,
            given.protocol,
            changes=given.changes,
            split=given.split,
            missing=given.missing,
            warn=odd.append,
        )
    except NothingToCount as nothing:
        found, why = nothing.found, str(nothing)
    except Fl3dError as error:
        _stop(str(error))
    _print(found, with_table=why is None)
    for line in odd:
        print(f"fl3d: warning: {line}", file=sys.stderr)
    if given.json:
        _write_json(given.json, found)
    if why is not None:
        _stop(why)


def _options() -> argparse.ArgumentParser:
    options = parser("evaluate", run.__doc__)
    options.epilog = EPILOG
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument(
        "labels",
        type=Path,
        metavar="LABELS",
        help="folder of label files, such as training/label_2",
    )
    options.add_argument(
        "results",
        type=Path,
        metavar="RESULTS",
        help="folder of result files, one a frame, named as its label file",
    )
    options.add_argument(
        "changes",
        nargs="*",
        metavar="KEY=VALUE",
        help="values of the protocol, such as 'overlaps.Car=[0.7,0.5,0.5]'; '+overlaps.Cone=[0.5,0.25,0.25]' adds a "
        "class of your own, '+neighbours.Cone=[Post]' what stands near it (docs/classes.md)",
    )
    options.add_argument(
        "--protocol",
        default="kitti",
        choices=protocol_names(),
        help="overlaps, variant and what easy, moderate and hard go by (default: kitti); see below",
    )
    options.add_argument(
        "--split",
        type=Path,
        metavar="FILE",
        help="frames to evaluate, one a line, such as ImageSets/val.txt (default: all of LABELS)",
    )
    options.add_argument(
        "--missing",
        default=MISSING[0],
        choices=MISSING,
        help="frames without a result file are left out (skip, the default), or nothing was found in them (empty)",
    )
    options.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="thresholds, counts, precisions and AP in full, and labels that do not count (ignored), by reason",
    )
    return options


def _print(found: Evaluated, with_table: bool) -> None:
    from fl3d.reports.counted import count_lines
    from fl3d.reports.evaluated import curves_to_markdown, heading

    print(f"{heading(found)}\n")
    if with_table:
        print(f"{curves_to_markdown(found.curves, found.protocol)}\n")
    for line in count_lines(found):
        print(line)
    sys.stdout.flush()


def _stop(why: str) -> NoReturn:
    print(f"fl3d: {why}", file=sys.stderr)
    sys.exit(NOTHING)


def _write_json(path: Path, found: Evaluated) -> None:
    import json

    from fl3d.core.files import write_text
    from fl3d.evaluation.average_precision import as_json

    try:
        write_text(path, json.dumps(as_json(found.curves, found.labels.ignored)) + "\n")
    except OSError as error:
        raise ConfigError(f"--json {path}: cannot be written ({error.strerror})") from None
