"""Anybody's detectors, as folders of KITTI result files, held against the labels of the same frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from fl3d.analysis.detectors import Detector
from fl3d.core.errors import ConfigError, DataError
from fl3d.data.drives import FILES as MAPPING
from fl3d.data.drives import has_mapping
from fl3d.data.label_table import LabelTable, read_table
from fl3d.evaluation import MISSING as MISSING_OF_ONE
from fl3d.evaluation.average_precision import Comparison, compare
from fl3d.evaluation.counts import ResultCounts, count_labels, count_results
from fl3d.evaluation.frames import Choice, choose_frames, read_results
from fl3d.evaluation.mistakes import find_mistakes
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol
from fl3d.reports.uncounted import label_warnings, result_warnings
from fl3d.runs.units import Units, units_of_frames

UNKNOWN = -999.0  # metres: KITTI writes -1000 where there is no 3D box
SHOWN = 3  # frames that are named where folders differ
VIEWS = {"3d": "3D", "bev": "bird's-eye", "image": "2D"}
MISSING = ("error", *MISSING_OF_ONE)


@dataclass(frozen=True)
class Held:
    """The results of some detectors held against the labels of the same frames.

    Args:
        ids: of the frames.
        detectors: in the order in which they are shown.
        runs: of each detector's name, a comparison for each of its runs.
        protocol: what an AP stands for.
        units: what is resampled.
        notes: what a reader must know of how frames were chosen.
    """

    ids: tuple[str, ...]
    detectors: tuple[Detector, ...]
    runs: Mapping[str, tuple[Comparison, ...]]
    protocol: Protocol
    units: Units
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the detectors."""
        return tuple(detector.name for detector in self.detectors)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What looks like a mistake in the labels or in a detector's results, as ``evaluate`` says it, a line each."""
        labels = next(iter(self.runs.values()))[0].gt
        counts = {
            name: [count_results(run.det, self.protocol) for run in own]
            for name, own in self.runs.items()
        }
        every = [one for own in counts.values() for one in own]
        lines = label_warnings(count_labels(labels, self.protocol), every)
        told = (line for name in self.names for line in self._warnings_of(name, counts[name]))
        return (*lines, *told)

    def _warnings_of(self, name: str, counts: Sequence[ResultCounts]) -> list[str]:
        """Of a detector, whose runs are counted; what several of them have is told of the first."""
        first: dict[str, str] = {}
        times: dict[str, int] = {}
        for run, count in zip(self.runs[name], counts, strict=True):
            for kind, text in result_warnings(count, find_mistakes(run)):
                first.setdefault(kind, text)
                times[kind] = times.get(kind, 0) + 1
        more = {kind: f" (so in {n} of its runs)" if n > 1 else "" for kind, n in times.items()}
        return [f"{name}: {text}{more[kind]}" for kind, text in first.items()]

    def metrics(self, name: str, class_name: str) -> tuple[str, ...]:
        """Metrics of the protocol for which every run of a detector that finds a class has boxes, see ``metrics_of``.

        A run that finds nothing has AP 0 in all of them. None where no run finds any, or where the protocol goes by
        heights in the picture and there are no 2D boxes: by it, none would count.
        """
        own = [metrics_of(one.det, class_name) for one in self._finding(name, class_name)]
        if not own or (self.protocol.uses_picture and not all("image" in have for have in own)):
            return ()
        return tuple(m for m in self.protocol.metrics if all(m in have for have in own))

    def _finding(self, name: str, class_name: str) -> list[Comparison]:
        """Runs of a detector that have any detection of a class."""
        return [one for one in self.runs[name] if one.det.of(class_name).any()]

    def collapsed(self, name: str, class_name: str) -> str:
        """Which runs of a detector find nothing of a class that others of its runs find, as a sentence; or nothing."""
        found = [one.det.of(class_name).any() for one in self.runs[name]]
        if all(found) or not any(found):
            return ""
        pairs = zip(self._folders(name), found, strict=True)
        empty = ", ".join(str(folder) for folder, has_any in pairs if not has_any)
        return f"{name} has no detection of {class_name} in {empty}: AP 0 there."

    def counts(self, class_name: str) -> bool:
        """Whether any ground truth of a class counts."""
        any_run = next(iter(self.runs.values()))[0]
        of_gt, _, _ = any_run.flags(class_name, self.protocol.metrics[-1], DIFFICULTIES[-1])
        return bool((of_gt == 0).any())

    def _folders(self, name: str) -> tuple[Path, ...]:
        return next(one.folders for one in self.detectors if one.name == name)

    def lacks(self, name: str, class_name: str) -> str:
        """Of which of the protocol's metrics a detector has no boxes of a class, and why, as a sentence; or nothing."""
        own = self.metrics(name, class_name)
        lacking = [VIEWS[metric] for metric in self.protocol.metrics if metric not in own]
        if not lacking:
            return ""
        if not self._finding(name, class_name):
            return f"{name} has no detection of {class_name}: no AP and no gain."
        if not own:
            return (
                f"{name} has no 2D boxes of {class_name}, and protocol {self.protocol.name} goes by their heights: "
                "no AP and no gain (--protocol lidar needs no 2D boxes)."
            )
        return f"{name} has no {' and no '.join(lacking)} boxes of {class_name}: no AP and no gain there."


def metrics_of(det: LabelTable, class_name: str) -> tuple[str, ...]:
    """Metrics for which there are boxes of a class: in the picture, from above, in space; none without detections."""
    boxes = det.values[det.of(class_name)]
    height, width, length, z = boxes[:, 7], boxes[:, 8], boxes[:, 9], boxes[:, 12]
    in_image = (boxes[:, 5] > boxes[:, 3]) & (boxes[:, 6] > boxes[:, 4])
    from_above = (width > 0) & (length > 0) & (z > UNKNOWN)
    have = {"image": in_image, "bev": from_above, "3d": from_above & (height > 0)}
    return tuple(metric for metric, is_box in have.items() if is_box.any())


def hold(
    labels: Path,
    detectors: Sequence[Detector],
    protocol: Protocol,
    split: Path | None = None,
    missing: str = "error",
    mapping: Path | None = None,
) -> Held:
    """Read the result files of detectors, and hold them against the labels.

    Args:
        labels: folder of label files.
        detectors: at least two, of different names.
        protocol: overlaps and variant; results are taken as they are, neither cut nor suppressed.
        split: file that names the frames to compare on; None: those that any folder has a result file of.
        missing: what becomes of a frame that a folder has no file of: ``error``; ``skip``, it is left out for all;
            ``empty``, nothing was found in it.
        mapping: folder of KITTI's mapping of frames to drives; None: ``mapping`` beside ``training``, if it is there.

    Raises:
        ConfigError: fewer than two detectors, two of one name, or a folder that stands for two runs.
        DataError: a folder or file is missing, malformed, or of other frames than the others.
    """
    names = [detector.name for detector in detectors]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"two detectors are named '{twice[0]}'; name them apart: NAME=FOLDER")
    _refuse_twice(detectors)
    if len(names) < 2:
        raise ConfigError("a comparison needs two detectors at least")
    of_folders = {
        folder: choose_frames(labels, folder, split, "empty")
        for one in detectors
        for folder in one.folders
    }
    frames, notes = _frames(of_folders, split is None, missing)
    gt = read_table(labels, frames, scored=False)
    runs = {
        one.name: tuple(
            compare(gt, _read(folder, frames, of_folders[folder]), protocol)
            for folder in one.folders
        )
        for one in detectors
    }
    folder = labels.resolve().parent.parent / "mapping" if mapping is None else mapping
    _check_mapping(mapping)
    units = units_of_frames(frames, folder, "--mapping")
    return Held(tuple(frames), tuple(detectors), runs, protocol, units, notes)


def _check_mapping(folder: Path | None) -> None:
    """Refuse a folder that was named and holds no mapping: frames would be taken as independent."""
    if folder is None:
        return
    if not folder.is_dir():
        raise DataError("no such folder of KITTI's mapping of frames to drives", folder)
    if not has_mapping(folder):
        raise DataError(
            f"holds no mapping of frames to drives; KITTI's development kit has {' and '.join(MAPPING)}",
            folder,
        )


def _refuse_twice(detectors: Sequence[Detector]) -> None:
    """A folder that stands for two runs would make a detector surer than it is, or be held against itself."""
    seen: dict[Path, tuple[str, Path]] = {}
    for one in detectors:
        for folder in one.folders:
            place = folder.resolve()
            if place not in seen:
                seen[place] = one.name, folder
                continue
            name, first = seen[place]
            if name == one.name:
                raise ConfigError(f"{name}: {folder} stands for two of its runs")
            raise ConfigError(
                f"{one.name}: {folder} is the folder that stands for a run of {name} ({first}); "
                "name a folder of its own"
            )


def _frames(
    of_folders: Mapping[Path, Choice], is_free: bool, missing: str
) -> tuple[list[str], tuple[str, ...]]:
    """Frames that are compared on, and what there is to be said of the choice.

    Args:
        of_folders: frames of each, those without a file among them.
        is_free: whether no split names the frames: they are those that any folder has a file of.
        missing: see ``hold``.
    """
    present = {folder: set(own.ids) - own.missing for folder, own in of_folders.items()}
    wanted = set().union(*present.values())
    if not is_free:
        wanted = set().union(*(own.ids for own in of_folders.values()))
    lacking = {folder: sorted(wanted - own) for folder, own in present.items()}
    lacking = {folder: frames for folder, frames in lacking.items() if frames}
    if not lacking:
        return sorted(wanted), ()
    told = [
        f"{folder} lacks {_listed(frames)} of {len(wanted)} frames"
        for folder, frames in lacking.items()
    ]
    if missing == "error":
        raise ConfigError(
            f"{'; '.join(told)}: --split FILE says on which frames to compare, --missing skip leaves these out for all "
            "detectors, --missing empty takes it that nothing was found in them"
        )
    what = "left out for all" if missing == "skip" else "taken as frames in which nothing was found"
    notes = tuple(f"{one}: {what}." for one in told)
    if missing == "empty":
        return sorted(wanted), notes
    shared = wanted.intersection(*present.values())
    if not shared:
        raise ConfigError(f"no frame is in all folders: {'; '.join(told)}")
    return sorted(shared), notes


def _listed(frames: Sequence[str]) -> str:
    """``5 (000001, 000002, 000003, ...)``."""
    more = ", ..." if len(frames) > SHOWN else ""
    return f"{len(frames)} ({', '.join(frames[:SHOWN])}{more})"


def _read(folder: Path, ids: Sequence[str], own: Choice) -> LabelTable:
    """Results of frames; nothing in those without a file."""
    present = set(own.ids) - own.missing
    return read_results(folder, replace(own, ids=tuple(ids), missing=frozenset(ids) - present))
