"""Evaluate any folder of KITTI result files, whoever wrote them."""

from __future__ import annotations

import re
from pathlib import Path

from fl3d.core.errors import DataError
from fl3d.data.label_table import read_table
from fl3d.evaluation.average_precision import Curves, average_r11, average_r40, compare, evaluate
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol

NUMBER = re.compile(r"\d+")


def evaluate_folder(labels: Path, results: Path, protocol: Protocol) -> tuple[Curves, int]:
    """Evaluate the frames that have a result file; an empty file counts, a missing one leaves its frame out.

    Args:
        labels: folder of label files, ``FRAME.txt``.
        results: folder of result files of the same names; what they hold is neither cut nor suppressed.
        protocol: overlaps and variant.

    Returns:
        the curves and the number of frames.

    Raises:
        DataError: a folder holds no such file, a label file is missing, or a line is malformed.
    """
    ids = result_ids(results, labels)
    gt, det = read_table(labels, ids, scored=False), read_table(results, ids, scored=True)
    return evaluate(compare(gt, det, protocol)), len(ids)


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
        if NUMBER.fullmatch(name) or (labels is not None and (labels / f"{name}.txt").exists())
    ]
    if not ids:
        raise DataError("holds no file FRAME.txt, such as 000001.txt", folder)
    return ids


def curves_to_markdown(curves: Curves) -> str:
    """R11 and R40 of every class and metric that has a ground truth, as Markdown."""
    head = [
        "class",
        "metric",
        *(f"{average} {level}" for average in ("R11", "R40") for level in DIFFICULTIES),
    ]
    lines = ["| " + " | ".join(head) + " |", "|---|---|" + "---:|" * 6]
    for name, metrics in curves.items():
        for metric, levels in metrics.items():
            if not any(curve.n_gt for curve in levels.values()):
                continue
            aps = [curve.ap_r11 for curve in levels.values()] + [
                curve.ap_r40 for curve in levels.values()
            ]
            lines.append("| " + " | ".join([name, metric, *(f"{ap:.4f}" for ap in aps)]) + " |")
            similar = [
                curve.orientation for curve in levels.values() if curve.orientation is not None
            ]
            if similar:
                aos = [
                    average(samples)
                    for average in (average_r11, average_r40)
                    for samples in similar
                ]
                lines.append(
                    "| " + " | ".join([name, "orientation", *(f"{v:.4f}" for v in aos)]) + " |"
                )
    return "\n".join(lines)
