"""A KITTI-format folder looked through before anything is trained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from numpy import bool_, uint8, zeros
from numpy.typing import NDArray

from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.config.settings import DataSettings, read_settings
from fl3d.core.errors import DataError, DataMissing
from fl3d.core.records import Config
from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import read_picture
from fl3d.inspection import MOST_CLOUDS
from fl3d.inspection.facts import Facts, gather
from fl3d.inspection.finding import Finding
from fl3d.inspection.summary import Checked, as_json, checked, overview
from fl3d.inspection.wanted import wanted_by
from fl3d.reports.figures.frame import draw_frame
from fl3d.sweep.prepare import prepare_data

ALL = "all"  # split of a folder without splits


@dataclass(frozen=True)
class Inspected:
    """What a look through a folder has found.

    Args:
        facts: what is there.
        result: what is learnt from, what is evaluated, and what is odd.
        train: split that is learnt from.
    """

    facts: Facts
    result: Checked
    train: str

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything that is wrong or odd, errors first."""
        return self.result.findings

    @property
    def errors(self) -> list[Finding]:
        """Those findings that would stop a sweep."""
        return self.result.errors

    @property
    def lines(self) -> tuple[str, ...]:
        """Three lines: what is learnt from, what is evaluated, what networks see."""
        return self.result.lines

    @property
    def overview(self) -> dict[str, str]:
        """What lies in the folder, by heading."""
        return dict(overview(self.facts))

    @property
    def table(self) -> pd.DataFrame:
        """A row a finding: ``severity``, ``file``, ``line``, ``files``, ``message``, ``advice``."""
        columns = ("severity", "file", "line", "files", "message", "advice")
        rows = [[getattr(one, column) for column in columns] for one in self.findings]
        return pd.DataFrame(rows, columns=list(columns))

    def as_json(self) -> dict[str, Any]:
        """Everything that was found, as values of JSON."""
        return as_json(self.facts, self.result)

    @cached_property
    def picture(self) -> Figure | None:
        """The frame with most targets, or else with most labels, drawn; None where no frame is whole.

        Raises:
            DataError: its cloud cannot be read.
        """
        frame_id = self._telling_frame
        if frame_id is None:
            return None
        kitti = self.facts.kitti
        frame = kitti.frame(frame_id)
        cloud = self.facts.clouds[frame_id]
        wanted: NDArray[bool_] = zeros(len(frame.labels), dtype=bool)
        for mask in cloud.targets.values():
            wanted |= mask
        counts = f"{cloud.points:,} points, {len(wanted)} labels, {wanted.sum()} targets"
        title = f"{kitti.root.name}, frame {frame_id}: {counts}"
        whole = kitti.read_cloud(frame_id).points_velo
        return draw_frame(frame, whole, self._image[0], wanted, title)

    @cached_property
    def _image(self) -> tuple[NDArray[uint8] | None, DataError | None]:
        frame_id = self._telling_frame
        file = None if frame_id is None else self.facts.kitti.path("image_2", frame_id)
        try:
            return (read_picture(file) if file and file.exists() else None), None
        except DataError as problem:
            return None, problem

    @property
    def picture_problem(self) -> DataError | None:
        """What is wrong with the frame's picture behind its header, which tells its size."""
        return self._image[1]

    @cached_property
    def _telling_frame(self) -> str | None:
        def told(frame_id: str) -> tuple[int, int]:
            cloud = self.facts.clouds[frame_id]
            return sum(int(mask.sum()) for mask in cloud.targets.values()), len(cloud.held)

        whole = [
            i
            for i in self.facts.looked_at(self.train)
            if None not in (self.facts.beside[i].labels, self.facts.beside[i].calibration)
        ]
        return max(whole, key=told, default=None)


def check(
    folder: Path | str | None = None,
    *words: str,
    clouds: int | None = MOST_CLOUDS,
    seen: Callable[[], object] = lambda: None,
) -> Inspected:
    """Look through a KITTI-format folder before anything is trained: ``fl3d check``.

    Args:
        folder: that holds ``training/`` and ``ImageSets/``; None: the one that the words name.
        words: what a sweep on it would be started with, such as ``"detector=pointrcnn"`` or ``"+sweep=gamma"``.
        clouds: of each split that are looked at, evenly chosen; None: all.
        seen: called after each file.

    Returns:
        what is there, what would be learnt from and counted, and what is odd.

    Raises:
        ConfigError: words that do not fit.
        DataMissing: the folder is no KITTI folder, or holds no labels.
    """
    root = None if folder is None else _root(Path(folder))
    asked = list(words)
    if root is not None and not any(word.startswith("data=") for word in asked):
        asked.insert(0, "data=kitti")
    configs = _configs(asked)
    settings = read_settings(configs[0])
    kitti = settings.data.folder(root or prepare_data(settings.data).root)
    splits, problems = splits_of(kitti, settings.data)
    train, val = next(iter(splits)), list(splits)[-1]
    facts = gather(kitti, splits, wanted_by(configs), settings.protocol, clouds, seen)
    return Inspected(facts, checked(facts, train, val, problems), train)


def _root(root: Path) -> Path:
    if not (root / "training").is_dir():
        inner = root.name == "training" and root.is_dir()
        hint = f"; give the folder above it, {root.parent}" if inner else ""
        raise DataMissing(f"is no KITTI folder: it holds no folder 'training'{hint}", root)
    return root


def _configs(words: Sequence[str]) -> list[Config]:
    """Of the trials that the words mean."""
    asked = multirun(words)
    sweeper = build(asked.sweeper, "hydra.sweeper").proposer(asked.arguments, asked.compose)
    return [point.config for point in sweeper.first()] or [sweeper.base]


def splits_of(
    kitti: KittiFolder, data: DataSettings
) -> tuple[dict[str, tuple[str, ...]], list[DataError]]:
    """Frames by name of the split, and what is wrong with the splits; all frames that have labels where there are none.

    Raises:
        DataMissing: there are no labels either.
    """
    found: dict[str, tuple[str, ...]] = {}
    problems: list[DataError] = []
    for name in dict.fromkeys((data.train_split, data.val_split)):
        try:
            found[name] = tuple(kitti.split(name))
            if not found[name]:
                problems.append(DataError("names no frame", kitti.split_path(name)))
        except DataError as error:
            problems.append(error)
    found = {name: ids for name, ids in found.items() if ids}
    if found:
        return found, problems
    labels = kitti.root / "training" / "label_2"
    ids = tuple(sorted(path.stem for path in labels.glob("*.txt")))
    if not ids:
        raise DataMissing("holds no label file, and there are no splits", labels)
    return {ALL: ids}, problems
