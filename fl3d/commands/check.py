"""``check``: a folder looked through before anything is trained."""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from fl3d.commands.words import parser
from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.config.settings import DataSettings, read_settings
from fl3d.core.errors import ConfigError, DataError, DataMissing
from fl3d.core.files import write_text
from fl3d.core.records import Config
from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import read_picture
from fl3d.inspection.facts import Facts, gather
from fl3d.inspection.summary import Checked, as_json, checked, overview
from fl3d.inspection.wanted import wanted_by
from fl3d.reports.figures.frame import draw_frame
from fl3d.sweep.prepare import prepare_data

EXAMPLES = """\
  check /data/kitti                                  all that a sweep with data=kitti would read
  check /data/mine detector=pointrcnn                by the rules of another detector
  check /data/mine data.crop=none protocol=lidar     of a folder without a camera, see docs/data.md
  check /data/mine +sweep=gamma                      of every detector of a sweep
  check /data/mine --clouds all --json found.json    every cloud, and everything that was found as JSON

Ends with code 2 where there are errors, so that a script can ask; warnings are odd but possible.
"""


MOST_CLOUDS = 200  # of each split, unless told otherwise
ALL = "all"  # of a folder without splits


def run(arguments: list[str]) -> None:
    """Look through a KITTI-format folder before anything is trained.

    It tells what is there, what a detector would learn from, what an evaluation would count, and what is wrong or odd,
    and draws one frame, so that an axis that is wrong is seen.
    """
    given = _options().parse_intermixed_args(arguments)
    root, words = _folder(given.words)
    configs = _configs(words)
    settings = read_settings(configs[0])
    kitti = settings.data.folder(root or prepare_data(settings.data).root)
    splits, problems = splits_of(kitti, settings.data)
    train, val = next(iter(splits)), list(splits)[-1]
    most = _most_clouds(given.clouds)
    with tqdm(unit="file", disable=None, leave=False) as bar:
        facts = gather(kitti, splits, wanted_by(configs), settings.protocol, most, bar.update)
    result = checked(facts, train, val, problems)
    if given.json != "-":
        _say(facts, result)
    _write_json(given.json, facts, result)
    _draw(given.picture, facts, train)
    if result.errors:
        sys.exit(2)


def _options() -> argparse.ArgumentParser:
    options = parser("check", inspect.cleandoc(run.__doc__ or ""))
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.epilog = EXAMPLES
    options.add_argument(
        "words",
        nargs="*",
        metavar="DATA [KEY=VALUE ...]",
        help="the folder that holds training/ and ImageSets/, and what a sweep on it would be started with",
    )
    options.add_argument(
        "--clouds",
        default=str(MOST_CLOUDS),
        metavar="N",
        help=f"clouds of each split that are looked at, evenly chosen, or all (default: {MOST_CLOUDS})",
    )
    options.add_argument(
        "--picture",
        type=Path,
        default=Path("out/check.png"),
        metavar="FILE",
        help="where a frame is drawn, as PNG (default: out/check.png)",
    )
    options.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="everything as JSON: to a file, or, without one, to the terminal instead of text",
    )
    return options


def _folder(words: list[str]) -> tuple[Path | None, list[str]]:
    """The folder among the words, and the others.

    Raises:
        ConfigError: there is no such folder, or there are two.
    """
    folders = [word for word in words if "=" not in word or Path(word).is_dir()]
    if len(folders) > 1:
        raise ConfigError(f"check looks at one folder: {', '.join(folders)} are {len(folders)}")
    rest = [word for word in words if word not in folders]
    if not folders:
        return None, rest
    root = Path(folders[0])
    if not (root / "training").is_dir():
        inner = root.name == "training" and root.is_dir()
        hint = f"; give the folder above it, {root.parent}" if inner else ""
        raise DataMissing(f"is no KITTI folder: it holds no folder 'training'{hint}", root)
    named = any(word.startswith("data=") for word in rest)
    return root, rest if named else ["data=kitti", *rest]


def _configs(words: list[str]) -> list[Config]:
    """Of the trials that the words mean."""
    asked = multirun(words)
    sweeper = build(asked.sweeper, "hydra.sweeper").proposer(asked.arguments, asked.compose)
    return [point.config for point in sweeper.first()] or [sweeper.base]


def _most_clouds(text: str) -> int | None:
    if text == ALL:
        return None
    if not text.isdigit():
        raise ConfigError(f"--clouds {text}: a number of clouds, or {ALL}")
    return int(text)


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


def _say(facts: Facts, result: Checked) -> None:
    print(f"{facts.kitti.root}\n")
    rows = overview(facts)
    wide = max(len(name) for name, _ in rows)
    for name, text in rows:
        print(f"  {name:{wide}}  {text}")
    print()
    for line in result.lines:
        print(line)
    print()
    for finding in result.findings:
        print(finding.text(facts.kitti.root))
    if not result.findings:
        print("Nothing odd was found.")


def _write_json(target: str | None, facts: Facts, result: Checked) -> None:
    if target is None:
        return
    text = json.dumps(as_json(facts, result), indent=1) + "\n"
    if target == "-":
        print(text, end="")
        return
    try:
        write_text(Path(target), text)
    except OSError as error:
        raise ConfigError(f"--json {target}: cannot be written ({error.strerror})") from None


def _draw(path: Path, facts: Facts, split: str) -> None:
    """Draw the frame with most targets, or else with most labels; one with a picture, where there are some."""
    frame_id = _telling_frame(facts, split)
    if frame_id is None:
        return
    kitti = facts.kitti
    frame = kitti.frame(frame_id)
    file = kitti.path("image_2", frame_id)
    image = _pixels(file) if file.exists() else None
    cloud = facts.clouds[frame_id]
    wanted = np.zeros(len(frame.labels), dtype=bool)
    for mask in cloud.targets.values():
        wanted |= mask
    counts = f"{cloud.points:,} points, {len(wanted)} labels, {wanted.sum()} targets"
    title = f"{kitti.root.name}, frame {frame_id}: {counts}"
    whole = kitti.read_cloud(frame_id).points_velo
    try:
        draw_frame(frame, whole, image, wanted, title, path.with_suffix(""))
    except OSError as error:
        raise ConfigError(f"--picture {path}: cannot be written ({error.strerror})") from None
    print(f"Drawn: {path.with_suffix('.png')}", file=sys.stderr)


def _pixels(file: Path) -> NDArray[np.uint8] | None:
    """Of a picture; None, and a line, where it is broken behind its header, which tells its size."""
    try:
        return read_picture(file)
    except DataError as problem:
        print(f"warning: {problem}", file=sys.stderr)
        return None


def _telling_frame(facts: Facts, split: str) -> str | None:
    def told(frame_id: str) -> tuple[int, int]:
        cloud = facts.clouds[frame_id]
        return sum(int(mask.sum()) for mask in cloud.targets.values()), len(cloud.held)

    whole = [
        i
        for i in facts.looked_at(split)
        if None not in (facts.beside[i].labels, facts.beside[i].calibration)
    ]
    return max(whole, key=told, default=None)
