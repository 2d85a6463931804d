"""Which frames of a folder of labels and a folder of results are evaluated."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fl3d.core.errors import ConfigError, DataError, options
from fl3d.data.label_table import LabelTable, read_table
from fl3d.data.splits import read_split
from fl3d.data.text import read_lines
from fl3d.evaluation import MISSING

SHOWN = 3  # names that an error lists
LABEL_FIELDS, RESULT_FIELDS = 15, 16


@dataclass(frozen=True)
class Choice:
    """Frames that are evaluated.

    Args:
        ids: of them, in order.
        wanted: how many there are to evaluate: all of the split, or all that have a label.
        missing: of those, the ones without a result file.
        split: file that names the frames; None: the folder of labels does.
        passed_over: text files among the results that are no frame's, such as ``README.txt``.
    """

    ids: tuple[str, ...]
    wanted: int
    missing: frozenset[str] = frozenset()
    split: Path | None = None
    passed_over: tuple[str, ...] = ()


def choose_frames(
    labels: Path, results: Path, split: Path | None = None, missing: str = "skip"
) -> Choice:
    """The frames of two folders that are evaluated.

    Args:
        labels: folder of label files, ``FRAME.txt``.
        results: folder of result files of the same names.
        split: file that names the frames to evaluate, one a line; None: those that have a label.
        missing: what becomes of a frame without a result file: ``skip``, it is left out; ``empty``, nothing was
            found in it.

    Raises:
        ConfigError: a choice that ``missing`` does not have.
        DataError: a folder is missing or holds no frame; a result is of no frame that has a label; a frame of the
            split has no label; no frame is left.
    """
    if missing not in MISSING:
        raise ConfigError(f"--missing: no choice '{missing}'. {options(missing, MISSING)}")
    labelled = _names(labels, "labels")
    found = _names(results, "results")
    strays = sorted(found - labelled)
    of_frames = [name for name in strays if _is_frame(results / f"{name}.txt", RESULT_FIELDS)]
    if split is None:
        if of_frames:
            raise _without_labels(of_frames, found, labelled, labels, results)
        wanted = {
            name
            for name in labelled
            if name in found or _is_frame(labels / f"{name}.txt", LABEL_FIELDS)
        }
    else:
        wanted = _of_split(split, labelled, labels)
    lacking = frozenset(wanted - found)
    ids = sorted(wanted - lacking if missing == "skip" else wanted)
    if not ids or lacking == wanted:
        raise DataError(
            f"holds no file of any of the {len(wanted)} frames to evaluate ({_listed(sorted(wanted))}), "
            f"only {_listed(sorted(found))}",
            results,
        )
    others = tuple(f"{name}.txt" for name in strays if name not in of_frames)
    return Choice(tuple(ids), len(wanted), lacking, split, others)


def read_results(folder: Path, choice: Choice) -> LabelTable:
    """Results of the chosen frames, none in those without a file.

    Raises:
        DataError: a line is malformed.
    """
    present = [frame_id for frame_id in choice.ids if frame_id not in choice.missing]
    table = read_table(folder, present, scored=True)
    sizes = np.zeros(len(choice.ids), dtype=np.int64)
    has_file = [frame_id not in choice.missing for frame_id in choice.ids]
    sizes[np.array(has_file, dtype=bool)] = np.diff(table.offsets)
    return replace(table, offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64))


def _names(folder: Path, what: str) -> set[str]:
    """Names of a folder's text files, without their ending."""
    if not folder.is_dir():
        raise DataError(f"no such folder of {what}", folder)
    names = {path.stem for path in folder.iterdir() if path.suffix == ".txt"}
    if not names:
        inner = sorted({path.parent.name for path in folder.glob("*/*.txt")})
        hint = f"; its folder {_listed(inner)} does" if inner else ""
        raise DataError(f"holds no file FRAME.txt, such as 000001.txt{hint}", folder)
    return names


def _is_frame(path: Path, fields: int) -> bool:
    """Whether a text file is a frame's: its name says so by a digit, or its first line by its fields."""
    if re.fullmatch(r"\d+", path.stem):
        return True
    if fields == LABEL_FIELDS and re.search(r"\d", path.stem):
        return True
    try:
        first = next((line.split() for line in read_lines(path) if line.strip()), [])
        return len([float(word) for word in first[1:fields]]) == fields - 1
    except (DataError, ValueError):
        return False


def _of_split(split: Path, labelled: set[str], labels: Path) -> set[str]:
    """Frames of a split, all of which have labels."""
    ids = read_split(split)
    if not ids:
        raise DataError("names no frame", split)
    unknown = [frame_id for frame_id in ids if frame_id not in labelled]
    if unknown:
        raise DataError(
            f"{_of_many(unknown, ids)} frames have no label file in {labels}: {_listed(unknown)}",
            split,
        )
    return set(ids)


def _without_labels(
    strays: Sequence[str], found: set[str], labelled: set[str], labels: Path, results: Path
) -> DataError:
    return DataError(
        f"{_of_many(strays, found)} result files are of frames without a label file in {labels}: "
        f"{_listed(strays)}; its labels are {_listed(sorted(labelled))}. To evaluate some frames alone, "
        "name them, one a line: --split FILE",
        results,
    )


def _of_many(some: Sequence[str], many: Iterable[str]) -> str:
    return f"{len(some)} of {len(list(many))}"


def _listed(names: Sequence[str]) -> str:
    """``000001, 000002, 000003, ...``."""
    return ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
