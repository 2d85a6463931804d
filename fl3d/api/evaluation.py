"""KITTI's official numbers of anybody's result files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from fl3d.config.protocols import read_protocol
from fl3d.core.errors import ConfigError, Fl3dError, ResultsWarning
from fl3d.evaluation import MISSING
from fl3d.evaluation.folders import Evaluated, evaluate_folder
from fl3d.evaluation.protocol import Protocol
from fl3d.reports.uncounted import mistakes_of, why_nothing
from fl3d.reports.uncounted import warnings as warnings_of

# What a protocol does to a detector's boxes and to objects beyond its range: results are taken as they are.
UNUSED = ("ignore_beyond", "image_box", "max_detections", "nms_iou", "nms_kind", "score_threshold")


class NothingToCount(Fl3dError):
    """Results were read, and no AP can be told of them.

    Args:
        why: a sentence.
        found: what was read, with the counts of what does not count.
    """

    def __init__(self, why: str, found: Evaluated) -> None:
        super().__init__(why)
        self.found = found


def evaluate(
    labels: Path | str,
    results: Path | str,
    protocol: str | Protocol = "kitti",
    *,
    changes: Sequence[str] = (),
    split: Path | str | None = None,
    missing: str = MISSING[0],
    warn: Callable[[str], object] | None = None,
) -> Evaluated:
    """Evaluate a folder of KITTI result files, whoever wrote them: ``fl3d evaluate``.

    The rules are KITTI's official ones. The results are taken as they are, neither cut nor suppressed.

    Args:
        labels: folder of label files, ``FRAME.txt``, such as ``training/label_2``.
        results: folder of result files of the same names; an empty one is a frame in which nothing was found.
        protocol: a name, such as ``kitti``, ``lidar`` or ``paper``, or a protocol.
        changes: of a protocol that is named, such as ``overlaps.Car=[0.7,0.5,0.5]``.
        split: file of the frames to evaluate, one a line; None: all of ``labels``.
        missing: ``skip``: a frame without a result file is left out; ``empty``: nothing was found in it.
        warn: is told what looks like a mistake in labels or results, or is odd, a line at a time; None: mistakes alone
            are warned of, as ``ResultsWarning``.

    Returns:
        APs by class, metric and difficulty, see ``Evaluated.table``; what counts, and why the rest does not.

    Raises:
        ConfigError: there is no such protocol, or a change does not fit it or would do nothing here.
        DataError: frames cannot be chosen, or a line is malformed.
        NothingToCount: no label or no result counts.
    """
    _refuse_unused(changes)
    chosen = protocol if isinstance(protocol, Protocol) else read_protocol(protocol, changes)
    file = None if split is None else Path(split)
    found = evaluate_folder(Path(labels), Path(results), chosen, file, missing)
    for line in mistakes_of(found) if warn is None else warnings_of(found):
        if warn is None:
            warnings.warn(line, ResultsWarning, stacklevel=2)
        else:
            warn(line)
    why = why_nothing(found)
    if why is not None:
        raise NothingToCount(why, found)
    return found


def _refuse_unused(changes: Sequence[str]) -> None:
    for change in changes:
        key = change.lstrip("+~").partition("=")[0].removeprefix("protocol.")
        if key in UNUSED:
            raise ConfigError(
                f"{change}: results are taken as they are, so {key} would do nothing here"
            )
