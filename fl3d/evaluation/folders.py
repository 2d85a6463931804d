"""Evaluate any folder of KITTI result files, whoever wrote them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fl3d.core.errors import DataError
from fl3d.data.label_table import read_table
from fl3d.data.text import read_lines
from fl3d.evaluation.average_precision import Curves, compare, evaluate
from fl3d.evaluation.counts import LabelCounts, ResultCounts, count_labels, count_results
from fl3d.evaluation.frames import LABEL_FIELDS, Choice, choose_frames, read_results
from fl3d.evaluation.mistakes import Mistake, find_mistakes
from fl3d.evaluation.protocol import Protocol

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Evaluated:
    """A folder of results, evaluated.

    Args:
        protocol: that it was evaluated under.
        frames: that were evaluated.
        curves: of every class, metric and difficulty.
        labels: how many count, and why the others do not.
        results: likewise.
        label_fields: of the first line of the first label file that has one.
        mistakes: what looks like a converter's, in the results.
    """

    protocol: Protocol
    frames: Choice
    curves: Curves
    labels: LabelCounts
    results: ResultCounts
    label_fields: int = LABEL_FIELDS
    mistakes: tuple[Mistake, ...] = ()

    @property
    def table(self) -> pd.DataFrame:
        """A row a class, metric and difficulty: ``ap_r11`` and ``ap_r40`` in percent, NaN where ``n_gt`` is 0."""
        import pandas as pd  # late: the command prints without it

        rows = []
        for name, metrics in self.curves.items():
            for metric, levels in metrics.items():
                for difficulty, curve in levels.items():
                    aps = (curve.ap_r11, curve.ap_r40) if curve.n_gt else (math.nan, math.nan)
                    rows.append([name, metric, difficulty, *aps, curve.n_gt])
        columns = ["class", "metric", "difficulty", "ap_r11", "ap_r40", "n_gt"]
        return pd.DataFrame(rows, columns=columns)


def evaluate_folder(
    labels: Path,
    results: Path,
    protocol: Protocol,
    split: Path | None = None,
    missing: str = "skip",
) -> Evaluated:
    """Evaluate a folder of results; they are taken as they are, neither cut nor suppressed.

    Args:
        labels: folder of label files, ``FRAME.txt``.
        results: folder of result files of the same names; an empty one counts.
        protocol: overlaps, variant and difficulty.
        split: see ``frames.choose_frames``.
        missing: likewise.

    Raises:
        ConfigError: the protocol goes by points, which needs clouds.
        DataError: frames cannot be chosen, see ``frames.choose_frames``, or a line is malformed.
    """
    frames = choose_frames(labels, results, split, missing)
    gt, det = read_table(labels, frames.ids, scored=False), read_results(results, frames)
    counts = count_labels(gt, protocol)
    held = compare(gt, det, protocol)
    return Evaluated(
        protocol,
        frames,
        evaluate(held),
        counts,
        count_results(det, protocol),
        _label_fields(labels, frames),
        find_mistakes(held),
    )


def _label_fields(folder: Path, frames: Choice) -> int:
    for frame_id in frames.ids:
        for line in read_lines(folder / f"{frame_id}.txt"):
            if line.strip():
                return len(line.split())
    return LABEL_FIELDS


def result_ids(folder: Path, labels: Path | None = None) -> list[str]:
    """Frames that have a file in a folder, in order: files named by digits, and those that have a label of their name.

    Args:
        folder: of the results.
        labels: of the labels; None: files that are not named by digits are left out.

    Raises:
        DataError: there is no such folder, or none of its files is named like a frame.
    """
    if not folder.is_dir():
        raise DataError("no such folder", folder)
    names = sorted(path.stem for path in folder.iterdir() if path.suffix == ".txt")
    ids = [
        name
        for name in names
        if name.isdigit() or (labels is not None and (labels / f"{name}.txt").exists())
    ]
    if not ids:
        raise DataError("holds no file FRAME.txt, such as 000001.txt", folder)
    return ids
