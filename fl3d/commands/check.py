"""``check``: a folder looked through before anything is trained."""

from __future__ import annotations

import argparse
import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fl3d.commands.parsing import parser
from fl3d.core.errors import ConfigError
from fl3d.core.loading import loading
from fl3d.inspection import MOST_CLOUDS

if TYPE_CHECKING:
    from fl3d.api.inspection import Inspected

EXAMPLES = """\
  check /data/kitti                                  all that a sweep with data=kitti would read
  check /data/mine detector=pointrcnn                by the rules of another detector
  check /data/mine data.crop=none protocol=lidar     of a folder without a camera, see docs/data.md
  check /data/mine +sweep=gamma                      of every detector of a sweep
  check /data/mine --clouds all --json found.json    every cloud, and everything that was found as JSON

Ends with code 2 where there are errors, so that a script can ask; warnings are odd but possible.
"""
ALL = "all"
DATA = ("data=", "data.root=")  # words that say which frames are meant
NOTHING_NAMED = (
    "which frames? Name the folder that holds training/ and ImageSets/, such as: check /data/kitti; or give "
    "data.root=FOLDER, or data=simulated for the frames that a sweep would simulate"
)


def run(arguments: list[str]) -> None:
    """Look through a KITTI-format folder before anything is trained.

    It tells what is there, what a detector would learn from, what an evaluation would count, and what is wrong or odd,
    and draws one frame, so that an axis that is wrong is seen.
    """
    options = _options()
    given = options.parse_intermixed_args(arguments)
    folder, words = _folder(given.words)
    if folder is None and not any(word.lstrip("+").startswith(DATA) for word in words):
        options.error(NOTHING_NAMED)
    with loading():
        from tqdm import tqdm

        from fl3d.api.inspection import check

    most = _most_clouds(given.clouds)
    with tqdm(unit="file", disable=None, leave=False) as bar:
        found = check(folder, *words, clouds=most, seen=bar.update)
    if given.json != "-":
        _say(found)
    _write_json(given.json, found)
    _draw(given.picture, found)
    if found.errors:
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
    return Path(folders[0]), rest


def _most_clouds(text: str) -> int | None:
    if text == ALL:
        return None
    if not text.isdigit():
        raise ConfigError(f"--clouds {text}: a number of clouds, or {ALL}")
    return int(text)


def _say(found: Inspected) -> None:
    root = found.facts.kitti.root
    print(f"{root}\n")
    rows = found.overview
    wide = max(map(len, rows))
    for name, text in rows.items():
        print(f"  {name:{wide}}  {text}")
    print()
    for line in found.lines:
        print(line)
    print()
    for finding in found.findings:
        print(finding.text(root))
    if not found.findings:
        print("Nothing odd was found.")


def _write_json(target: str | None, found: Inspected) -> None:
    import json

    from fl3d.core.files import write_text

    if target is None:
        return
    text = json.dumps(found.as_json(), indent=1) + "\n"
    if target == "-":
        print(text, end="")
        return
    try:
        write_text(Path(target), text)
    except OSError as error:
        raise ConfigError(f"--json {target}: cannot be written ({error.strerror})") from None


def _draw(path: Path, found: Inspected) -> None:
    """Draw the frame with most targets, or else with most labels."""
    from fl3d.reports.figures.style import save

    drawn = found.picture
    if drawn is None:
        return
    if found.picture_problem is not None:
        print(f"warning: {found.picture_problem}", file=sys.stderr)
    try:
        save(drawn, path.with_suffix(""), (".png",))
    except OSError as error:
        raise ConfigError(f"--picture {path}: cannot be written ({error.strerror})") from None
    print(f"Drawn: {path.with_suffix('.png')}", file=sys.stderr)
