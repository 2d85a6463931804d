"""The generated parts of the site: commands, config keys, protocols and the Python API, as Markdown."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml

import fl3d
from fl3d.cli import COMMANDS, main
from fl3d.config.compose import CONF
from fl3d.config.objects import locate
from fl3d.config.rules import LAUNCHER, OPTIMIZER, RULES, Rule
from fl3d.core.typed import type_text

WIDTH = 100  # columns of a command's help
# Groups of the config, in the order of the page, and what a file of each is.
GROUPS = {
    "data": "where frames come from",
    "profile": "how large a sweep is",
    "detector": "a network, its loss and its optimiser",
    "loss": "put in place of the detector's loss",
    "schedule": "the stages of a trial",
    "hydra/launcher": "where stages run",
    "hydra/sweeper": "which trials are asked for",
}
# Sections that a class is made of without a ``_target_``, whose docstring says what their keys mean.
MADE_OF = {
    "detector.anchors": "fl3d.detectors.anchors.Anchors",
    "detector.rcnn": "fl3d.detectors.point_nets.Refinement",
    "detector.rcnn.rois": "fl3d.detectors.rois.RoiRule",
    "detector.slabs": "fl3d.points.slabs.Slabs",
    "detector.refine.slabs": "fl3d.points.slabs.Slabs",
    "loss": "fl3d.losses.DetectionLoss",
}
MEANINGS: dict[str, str] = {}  # by key, see ``collect_meanings``
LINE = re.compile(r"^(?P<indent> *)(?P<key>[\w./]+):(?P<value>(?: [^#\n]*)?)(?:#\s*(?P<says>.*))?$")


@dataclass(frozen=True)
class Key:
    """A key of a YAML file.

    Args:
        name: in dots, from the config's root.
        value: as the file writes it; empty: a section.
        meaning: what the comment behind it says; may be empty.
    """

    name: str
    value: str
    meaning: str


def commands() -> str:
    """The help of every command, as a terminal shows it."""
    parts = [("train (no command's name)", ["--help"])]
    parts += [(name, [name, "--help"]) for name in sorted(COMMANDS)]
    return "\n\n".join(f"## {title}\n\n```text\n{help_of(words)}\n```" for title, words in parts)


def help_of(words: list[str]) -> str:
    """What a command prints when it is asked for help."""
    os.environ["COLUMNS"] = str(WIDTH)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main(words)
    text, _, _ = printed.getvalue().partition("\n== Config")  # which has a page of its own
    return text.strip()


def config() -> str:
    """Every key of every YAML file of the config: default, what it may be, meaning."""
    collect_meanings()
    parts = ["## Every trial\n\n" + table(keys_of(CONF / "config.yaml"))]
    for group, what in GROUPS.items():
        parts.append(f"## {group}\n\n`{group}=NAME`: {what}.")
        parts += [option(group, path) for path in sorted((CONF / group).glob("*.yaml"))]
    return "\n\n".join(parts)


def collect_meanings() -> None:
    """What comments say of keys, for the files that have the same keys without a comment; the first one counts."""
    files = [
        CONF / "config.yaml",
        *sorted(CONF.glob("*/*.yaml")),
        *sorted(CONF.glob("hydra/*/*.yaml")),
    ]
    for key in [key for path in files for key in keys_of(path)]:
        if key.meaning:
            MEANINGS.setdefault(general(key.name), key.meaning)


def general(name: str) -> str:
    """A key without the name of a stage."""
    return re.sub(r"^schedule\.stages\.\w+\b", "schedule.stages.*", name)


def option(group: str, path: Path) -> str:
    """A file of a group: its head, and its keys."""
    head, _, _ = path.read_text(encoding="utf-8").partition("\n\n")
    lines = [line[1:].strip() for line in head.splitlines() if line.startswith("#")]
    told = [line for line in lines if not line.startswith("@package")]
    return f"### {group}={path.stem}\n\n{escaped(' '.join(told))}\n\n{table(keys_of(path))}"


def keys_of(path: Path) -> list[Key]:
    """The keys of a YAML file, with the comments behind them."""
    text = path.read_text(encoding="utf-8")
    is_global = "@package _global_" in text
    group = path.parent.relative_to(CONF).as_posix().replace("/", ".").strip(".")
    root = "" if is_global or not group else f"{group}."
    return [
        key
        for key in lines_of(text)
        if not key.name.startswith(
            ("defaults", "hydra.help", "hydra.run", "hydra.sweep.", "hydra.output_subdir")
        )
        and key.name != "hydra.sweep"
        for key in [Key(root + key.name, key.value, key.meaning)]
    ]


def lines_of(text: str) -> Iterator[Key]:
    """Keys line by line; items of lists and long texts belong to the key above them."""
    parents: list[tuple[int, str]] = []
    for line in text.splitlines():
        match = LINE.match(line)
        if match is None:
            continue
        indent = len(match["indent"])
        parents = [(depth, name) for depth, name in parents if depth < indent]
        name = ".".join([*(name for _, name in parents), match["key"]])
        parents.append((indent, match["key"]))
        yield Key(name, match["value"].strip(), (match["says"] or "").strip())


def table(keys: list[Key]) -> str:
    """Keys as a table; sections have no row, but where their comment says something."""
    classes = MADE_OF | {
        key.name.removesuffix("._target_"): key.value
        for key in keys
        if key.name.endswith("._target_")
    }
    rows = ["| key | default | may be | meaning |", "|---|---|---|---|"]
    for key in keys:
        if not key.value and not key.meaning:
            continue
        may_be, meaning = by_rule(key.name), key.meaning
        section, _, name = key.name.rpartition(".")
        if section in classes and name != "_target_":
            hint, told = by_class(classes[section], name)
            may_be, meaning = may_be or hint, meaning or told
        if key.name.endswith("_target_"):
            meaning = meaning or "the class that is built; another one may stand here"
        meaning = meaning or MEANINGS.get(general(key.name), "")
        if not meaning and key.name.startswith(
            "detector.refine."
        ):  # the second stage has the first's keys
            meaning = by_class("fl3d.detectors.fconvnet.FConvNet", name)[1]
        meaning = re.sub(r"^\| ", "also: ", meaning)  # the other choices, behind the default
        cells = (code(key.name), code(key.value), escaped(may_be), escaped(meaning))
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) if len(rows) > 2 else ""


def by_rule(name: str) -> str:
    """What the table of rules says that a key may be; empty: it has no rule there."""
    section, _, last = name.rpartition(".")
    rules: dict[str, dict[str, Rule]] = {"optimizer": OPTIMIZER, "hydra.launcher": LAUNCHER}
    if section in rules:
        return rules[section][last].says if last in rules[section] else ""
    fitting = [
        rule
        for key, rule in RULES.items()
        if key.count(".") == name.count(".") and fnmatchcase(name, key)
    ]
    return fitting[0].says.replace("any value", "") if fitting else ""


def by_class(target: str, name: str) -> tuple[str, str]:
    """What an argument of a class may be, by its type, and what the docstring says of it."""
    kind = locate(target, "docs")
    try:
        hints = typing.get_type_hints(kind.__init__, include_extras=True)
    except (AttributeError, NameError, TypeError):  # names that only a type checker knows
        hints = {}
    told = said_of(kind, name) if target.startswith("fl3d.") else ""
    return (type_text(hints[name]) if name in hints else ""), told


def said_of(kind: type[Any], name: str) -> str:
    """A line of ``Args:`` in a class's docstring, or in that of a class above it."""
    for one in kind.__mro__:
        text = inspect.cleandoc(one.__doc__ or "").partition("Args:\n")[2]
        match = re.search(rf"^    {name}: (.*(?:\n        .*)*)", text, re.MULTILINE)
        if match:
            return " ".join(match[1].replace("``", "`").split())
    return ""


def protocols() -> str:
    """A table of all protocols: a row for each value."""
    found = {path.stem: values_of(path) for path in sorted((CONF / "protocol").glob("*.yaml"))}
    names = list(found)
    keys = [key for key in found["paper"] if key != "name"]
    rows = ["| `protocol.` | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for key in keys:
        rows.append(
            f"| `{key}` | " + " | ".join(text_of(found[name].get(key)) for name in names) + " |"
        )
    parts = [said_of(locate("fl3d.evaluation.protocol.Protocol", "docs"), key) for key in keys]
    meanings = [f"| `{key}` | {escaped(told)} |" for key, told in zip(keys, parts, strict=True)]
    return "\n".join(rows) + "\n\n| key | meaning |\n|---|---|\n" + "\n".join(meanings)


def values_of(path: Path) -> dict[str, Any]:
    """The values of a protocol, those that it takes from another among them."""
    own = yaml.safe_load(path.read_text(encoding="utf-8"))
    above: dict[str, Any] = {}
    for name in own.pop("defaults", []):
        above |= values_of(path.with_name(f"{name}.yaml"))
    return {**above, **own}


def text_of(value: Any) -> str:
    """A value as a cell."""
    if isinstance(value, dict):
        return "<br>".join(f"{name} {'/'.join(map(str, one))}" for name, one in value.items())
    return "–" if value is None else str(value)


def api() -> str:
    """A directive for each public name, which mkdocstrings fills in."""
    parts = []
    for name in getattr(fl3d, "__all__", ()):
        thing = getattr(fl3d, name)
        if callable(thing):
            parts.append(
                f"::: {thing.__module__}.{thing.__qualname__}\n    options:\n      heading_level: 2"
            )
    return "\n\n".join(parts)


def code(text: str) -> str:
    """A text as code in a table's cell."""
    return f"`{text.replace('|', chr(92) + '|')}`" if text else ""


def escaped(text: str) -> str:
    """A text in a table's cell; what looks like HTML or a place stays as it is."""
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").replace("_", "\\_")


PARTS = {"commands": commands, "config": config, "protocols": protocols, "api": api}
