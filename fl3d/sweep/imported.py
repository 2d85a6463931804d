"""Result folders that are there already become trials of a sweep: found, checked, and stored as a command's are."""

from __future__ import annotations

import copy
import csv
import glob
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, DataError, options
from fl3d.core.leases import leased
from fl3d.core.records import Config
from fl3d.evaluation.results import read_results, results_digest, write_results
from fl3d.runs.spec import Spec, write_spec
from fl3d.sweep.plan import Plan
from fl3d.sweep.setup import Prepared, machine
from fl3d.sweep.sweepers.base import Point
from fl3d.training.command import TARGET
from fl3d.training.result_folders import check_frames, pattern_regex
from fl3d.training.running import StageRun
from fl3d.training.templates import names_in

STAGE = "imported"
MARKS = {"level": "\x01", "seed": "\x02", "epoch": "\x03", "detector": "\x04"}
FITS = {"level": "([^/]+)", "seed": r"(\d+)", "epoch": r"(\d+)", "detector": "([^/]+)"}
COLUMNS = ("level", "seed", "epoch", "folder")


@dataclass(frozen=True, kw_only=True)
class Result:
    """The results of one checkpoint.

    Args:
        folder: of its result files.
        level: of the factor, as data.
        seed: of its training.
        epoch: after which it was made; 1 where nobody says.
        detector: its name; empty: the one that all have.
    """

    folder: Path
    level: Any
    seed: int
    epoch: int
    detector: str = ""

    @property
    def place(self) -> tuple[str, Any, int]:
        """What it shares with the other checkpoints of its trial."""
        return self.detector, self.level, self.seed


def find_results(pattern: str) -> list[Result]:
    """Result folders that fit a pattern such as ``{level}/seed{seed}/epoch_{epoch}/data``.

    Args:
        pattern: of the folders; ``*`` fits anything within a name, and all places but ``{level}`` may be missing.

    Raises:
        ConfigError: a place that there is not, or no ``{level}``.
        DataError: no folder fits.
    """
    names = names_in(pattern, "import")
    for name in names:
        if name not in MARKS:
            raise ConfigError(f"import: {pattern}: no place {{{name}}}. {options(name, MARKS)}")
    if "level" not in names:
        raise ConfigError(
            f"import: {pattern} has no {{level}}, the place of the value that is compared"
        )
    marked = pattern
    for name, mark in MARKS.items():
        first, *rest = marked.split(f"{{{name}}}")
        marked = mark.join([first, *rest])
    marked = str(Path(marked))
    regex = re.compile(pattern_regex(marked, {MARKS[name]: FITS[name] for name in MARKS}))
    order = sorted(names, key=lambda name: marked.index(MARKS[name]))
    found = []
    for name in sorted(glob.glob(re.sub("[\x01-\x04]", "*", marked), recursive=True)):
        match = regex.fullmatch(name)
        if match is not None and Path(name).is_dir():
            said = dict(zip(order, match.groups(), strict=True))
            found.append(_result(Path(name), said))
    if not found:
        raise DataError(f"no folder fits the pattern; {_there(marked)}", pattern)
    return found


def read_list(path: Path) -> list[Result]:
    """Result folders that a CSV file lists: columns level, seed, epoch, folder, and perhaps detector.

    Args:
        path: of the file; folders are relative to where it lies.

    Raises:
        DataError: there is no such file or folder, a column is missing, or a number is none.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", path) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"is no CSV of text in UTF-8 ({error})", path) from None
    found = []
    for number, row in enumerate(rows, start=2):
        missing = [name for name in COLUMNS if not row.get(name)]
        if missing:
            raise DataError(
                f"has no {', '.join(missing)}; columns are {', '.join(COLUMNS)}", path, number
            )
        for name in ("seed", "epoch"):
            if not row[name].strip().isdecimal():  # ² is a digit
                raise DataError(f"{name} '{row[name]}' is no whole number", path, number)
        if not (path.parent / row["folder"]).is_dir():
            raise DataError(f"there is no folder '{row['folder']}' beside it", path, number)
        found.append(_result(path.parent / row["folder"], row))
    if not found:
        raise DataError(f"lists no folder; columns are {', '.join(COLUMNS)}", path)
    return found


def _result(folder: Path, said: dict[str, str]) -> Result:
    return Result(
        folder=folder.resolve(),
        level=_value(said["level"]),
        seed=int(said.get("seed") or 0),
        epoch=int(said.get("epoch") or 1),
        detector=said.get("detector") or "",
    )


def _value(text: str) -> Any:
    """A level as data: a number where it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _there(marked: str) -> str:
    """What there is where a pattern fits nothing."""
    place = Path(re.split(r"[\x01-\x04*?\[]", marked)[0] + "x").parent
    while not place.is_dir():
        place = place.parent
    names = sorted(f"{one.name}/" if one.is_dir() else one.name for one in place.iterdir())
    return f"there is {', '.join(names[:12]) or 'nothing'}{' ...' if len(names) > 12 else ''} in {place}"


@dataclass(frozen=True)
class Import:
    """Results as trials.

    Args:
        results: of all checkpoints.
        base: config that all trials share.
        factor: what the levels are values of.
        name: of the detector, where the results do not say.
        ids: of the validation frames.
    """

    results: Sequence[Result]
    base: Config
    factor: str
    name: str
    ids: Sequence[str]

    def points(self) -> list[Point]:
        """A point of each trial.

        Raises:
            DataError: results of other frames, of one epoch twice, or the same files twice.
        """
        trials: dict[tuple[str, Any, int], dict[int, Path]] = {}
        for one in self.results:
            check_frames(one.folder, self.ids)
            other = trials.setdefault(one.place, {}).setdefault(one.epoch, one.folder)
            if other != one.folder:
                raise DataError(f"is of the same level, seed and epoch as {other}", one.folder)
        seen: dict[str, Path] = {}
        points = []
        for place, folders in trials.items():
            digests = {epoch: results_digest(folder, self.ids) for epoch, folder in folders.items()}
            last = max(folders)
            other = seen.setdefault(digests[last], folders[last])
            if other != folders[last]:
                raise DataError(
                    f"holds the very files of {other}, of another level or seed", folders[last]
                )
            points.append(self._point(place, folders, digest(sorted(digests.items()))))
        return points

    def _point(self, place: tuple[str, Any, int], folders: dict[int, Path], found: str) -> Point:
        detector, level, seed = place
        config = copy.deepcopy(self.base)
        about = f"{len(folders)} folders of result files, digest {found[:16]}"
        config["detector"] = {
            "_target_": TARGET,
            "name": detector or self.name,
            "run": None,
            "results": {str(epoch): str(folder) for epoch, folder in sorted(folders.items())},
            "program": {
                "folder": str(folders[max(folders)].parent),
                "digest": found,
                "about": about,
            },
            "imported": True,
        }
        config["seed"] = seed
        epochs = max(1, *folders)
        config["schedule"] = {**config["schedule"], "stages": {STAGE: {"epochs": epochs}}}
        named = {"detector": detector} if detector else {}
        values = {**named, self.factor: level, "seed": seed}
        return Point(tuple(f"{key}={value}" for key, value in values.items()), values, config)


def keep(prepared: Prepared, plan: Plan, say: Callable[[str], None]) -> int:
    """Store the results of trials that are not stored yet; how many there were.

    Raises:
        DataError: a result file cannot be read.
    """
    added = 0
    for stage in plan.stages.values():
        folder = prepared.layout.run(stage.key)
        if folder.is_done:
            continue
        write_spec(folder, Spec(stage, machine(prepared)))
        with leased(folder.lease) as lease:
            _ImportRun(folder, lease, Spec(stage, machine(prepared))).run()
        added += 1
        say(f"{stage.key}: {len(folder.steps())} checkpoints")
    return added


class _ImportRun(StageRun):
    """Stores and scores results as a command's are."""

    def run(self) -> None:
        validation = self.validation()
        section = self.stage.config["detector"]
        for text, path in section["results"].items():
            results = read_results(Path(path), self.machine.val_ids, self.machine.protocol.classes)
            write_results(self.folder.detections(int(text)), results)
            self.score(int(text), validation)
            self.mark(
                int(text),
                int(text),
                seconds={},
                made_by={
                    "program": section["program"]["about"],
                    "program.folder": section["program"]["folder"],
                    "results": path,
                    "results.sha256": results.sha256,
                },
            )
        self.end(self.folder.steps()[-1])
