"""What sweeps and trials are called that were typed by hand, without a name.

A name is made of what is swept and of all that was typed, so that two different ones never meet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import yaml

from fl3d.config.overrides import is_interval, is_range, values_by_key
from fl3d.config.places import is_group, own_file
from fl3d.config.settings import BY_HAND
from fl3d.core.digests import digest
from fl3d.reports.levels import slug
from fl3d.runs.design import SEED, label_of, short_names

# Keys that say where and how a sweep runs, and not what it trains; data= and profile= are in its folder's name.
PLACES = (
    "data",
    "data.root",
    "data.mapping",
    "data.cache_frames",
    "profile",
    "results",
    "device",
    "workers",
    "schedule.save_every_steps",
)
SECTIONS = ("store", "sweep", "hydra")
FILE = "sweep"  # chooses a sweep file, which may have no name in it
DESIGN = ("sweep.factor", "sweep.baseline", "sweep.groups")  # what a sweep compares
DIGITS = 8  # of a digest: of a thousand sweeps typed by hand two meet with a chance of one in ten thousand
NAME_LETTERS = 60  # of swept keys in a name

Told = Mapping[str, frozenset[str]]


def told(words: Iterable[str]) -> Told:
    """Labels of the values that words name of what is trained, by key; an interval is one label."""
    return {key: frozenset(labels) for key, labels in labels_of(words).items()}


def labels_of(words: Iterable[str], text: Callable[[Any], str] = label_of) -> dict[str, list[str]]:
    """The same, with the texts of a key in the order of its values; what is left out has a key with ``~``."""
    found: dict[str, list[str]] = {}
    for word in words:
        key = word.partition("=")[0].lstrip("+~")
        if _is_elsewhere(key):
            continue
        if word.startswith("~"):
            found[f"~{key}"] = [""]
        elif is_interval(word):
            found[key] = [word.partition("=")[2]]
        else:
            for name, values in values_by_key([word]).items():
                found[name] = list(dict.fromkeys(text(value) for value in values))
    return found


def _is_elsewhere(key: str) -> bool:
    """Whether a key says nothing of what is trained; the choice of a sweep file does."""
    return key in PLACES or (key != FILE and key.partition(".")[0].partition("/")[0] in SECTIONS)


def sweep_name(
    words: Sequence[str],
    params: Mapping[str, object] | None = None,
    search: Mapping[str, object] | None = None,
) -> str:
    """What a sweep of these words is called.

    More seeds are the same sweep. Another value is another, and so is another first one, which is the baseline, another
    design (``sweep.baseline`` and the like), a search among the values of a grid, and a YAML of the user's that says
    something else than one of its name in another folder.

    Of a search, which is resumed as one study, other seeds, another order, another kind of values (a range for a
    choice) and other settings are another too.

    Args:
        words: as typed.
        params: values that its sweeper was given, by key, in Hydra's grammar.
        search: settings of the sweeper that picks among the values; None: all are trained.
    """
    labels = labels_of(words, _exact)
    if search is None:
        labels = {key: [*values[:1], *sorted(values[1:])] for key, values in labels.items()}
    seeds = labels.get(SEED, []) if search is not None else labels.pop(SEED, [])
    intervals = {word.partition("=")[0].lstrip("+") for word in words if is_interval(word)}
    swept = [key for key, values in labels.items() if len(values) > 1 or key in intervals]
    swept += [key for key in params or {} if key not in (*swept, SEED)]
    names = list(short_names([key for key in swept if key != SEED]).values())
    also = {
        "params": {
            key: str(value)
            for key, value in (params or {}).items()
            if key != SEED or search is not None
        },
        "design": sorted(word.lstrip("+") for word in words if _is_design(word)),
        "ranges": sorted(word.lstrip("+") for word in words if is_range(word)) if search else [],
        "search": search,
        "own": _own_files(words),
    }
    marks = {key: value for key, value in also.items() if value}
    shown = slug(" ".join(names or ([SEED] if seeds else [])))[:NAME_LETTERS]
    parts = [BY_HAND, shown, digest([labels, marks])[:DIGITS]]
    return "-".join(part for part in parts if part)


def _own_files(words: Iterable[str]) -> dict[str, str]:
    """What the user's own YAMLs say that words choose, by group and option; comments in them say nothing."""
    found = {}
    for word in words:
        group = word.partition("=")[0].lstrip("+")
        if is_group(group) and not group.startswith(
            "hydra/"
        ):  # which says where, and in what order
            for option in values_by_key([word])[group]:
                file = own_file(group, option)
                if file is not None:
                    content = yaml.safe_load(file.read_text(encoding="utf-8"))
                    found[f"{group}/{option}"] = repr(content)
    return found


def _exact(value: Any) -> str:
    """A value as people write it, and of an object the whole name of its class."""
    return repr(value) if "_target_" in repr(value) else label_of(value)


def _is_design(word: str) -> bool:
    """Whether a word says what is compared with what."""
    return word.partition("=")[0].lstrip("+~") in DESIGN


def trial_name(values: object) -> str:
    """What a single trial is called: two of the same values are one, however they were typed.

    Args:
        values: all that can change a result.
    """
    return f"{BY_HAND}.{digest(values)[:DIGITS]}"
