"""Sweeps and trials that were typed by hand, without a name: what they are called, and which of them words mean.

A name is made of what is swept and of all that was typed, so that two different ones never meet; words find a sweep
again by what it was started with, which its plan keeps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fl3d.config.detector_names import spell_out_detectors
from fl3d.config.overrides import is_interval, is_range, values_by_key
from fl3d.config.settings import BY_HAND, Settings
from fl3d.core.digests import digest
from fl3d.core.errors import StoreError
from fl3d.reports.levels import slug
from fl3d.runs.design import DETECTOR, SEED, label_of, short_names
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import FrozenPlan, read_plan

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


@dataclass(frozen=True)
class _Found:
    """A sweep that was typed by hand: its name, its plan, and when it was started last."""

    name: str
    plan: FrozenPlan
    started: float


def told(words: Iterable[str]) -> Told:
    """Labels of the values that words name of what is trained, by key; an interval is one label."""
    return {key: frozenset(labels) for key, labels in _in_order(words, label_of).items()}


def _in_order(words: Iterable[str], text: Callable[[Any], str]) -> dict[str, list[str]]:
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
    design (``sweep.baseline`` and the like), and a search among the values of a grid.

    Of a search, which is resumed as one study, other seeds, another order, another kind of values (a range for a
    choice) and other settings are another too.

    Args:
        words: as typed.
        params: values that its sweeper was given, by key, in Hydra's grammar.
        search: settings of the sweeper that picks among the values; None: all are trained.
    """
    labels = _in_order(words, _exact)
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
    }
    marks = {key: value for key, value in also.items() if value}
    shown = slug(" ".join(names or ([SEED] if seeds else [])))[:NAME_LETTERS]
    parts = [BY_HAND, shown, digest([labels, marks])[:DIGITS]]
    return "-".join(part for part in parts if part)


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


def find_by_hand(settings: Settings, words: Sequence[str], name: str = "") -> Settings:
    """The settings of the sweep typed by hand that words mean.

    It is the one that was started with them, or else the last that was started with these values among its own.

    Args:
        settings: as the words say, without a name.
        words: as typed; a key may be short: ``gamma=2``.
        name: what a sweep that was started with them is called.

    Raises:
        StoreError: none fits; the message lists those that there are.
    """
    asked = told(words)
    every = _by_hand(settings)
    fitting = [one for one in every if _fits(one.plan, asked)]
    if not fitting:
        here = "; ".join(f"{one.name}: {' '.join(_shown(one.plan))}" for one in every)
        raise StoreError(
            f"{settings.store.root}: no sweep typed by hand on {settings.folder_name} has "
            f"{' '.join(_labels(asked)) or 'any trial'}. "
            + (
                f"There are {here}"
                if here
                else "There is none; a sweep file is named by +sweep=NAME"
            )
        )
    same = [one for one in fitting if one.name == name] or [
        one for one in fitting if told(one.plan.words) == asked
    ]
    chosen = max(same or fitting, key=lambda one: one.started)
    return replace(settings, sweep=replace(settings.sweep, name=chosen.name))


def has_by_hand(settings: Settings, words: Sequence[str]) -> bool:
    """Whether a sweep typed by hand has trials with these values."""
    asked = told(words)
    return any(_fits(one.plan, asked) for one in _by_hand(settings))


def names_by_hand(settings: Settings) -> list[str]:
    """Names of the sweeps typed by hand that compare several levels, as they were started."""
    found = sorted(_by_hand(settings), key=lambda one: one.started)
    return [one.name for one in found if len({trial.level for trial in one.plan.trials}) > 1]


def _by_hand(settings: Settings) -> list[_Found]:
    found = []
    end = f"-{settings.folder_name}.json"
    for path in sorted(StoreFolder(settings.store.root).plans.glob(f"{BY_HAND}*{end}")):
        name = path.name.removesuffix(end)
        if name.removeprefix(BY_HAND)[:1] not in ("", "-", "."):
            continue
        try:
            found.append(_Found(name, read_plan(path), path.stat().st_mtime))
        except (OSError, StoreError):  # of another version, or torn: as good as not there
            continue
    return found


def _fits(plan: FrozenPlan, asked: Told) -> bool:
    found = {key: _values(plan, key) for key in asked}
    if not plan.words:  # of a plan that older code wrote only what its trials differ in is known
        found = {key: values for key, values in found.items() if values and key != DETECTOR}
    return bool(plan.trials) and all(asked[key] <= values for key, values in found.items())


def _values(plan: FrozenPlan, key: str) -> frozenset[str]:
    """Labels of the values that a plan's trials have under a key, which may be the last part of one."""
    found: set[str] = set()
    for name, values in told(plan.words).items():
        if _is_named(name, key):
            found |= values
    for trial in plan.trials:
        own = {**trial.config, **trial.values, SEED: trial.seed}
        found |= {label_of(value) for name, value in own.items() if _is_named(name, key)}
        if key == DETECTOR:  # by either of its names, typed or not
            given = spell_out_detectors([f"{DETECTOR}={trial.detector}"])[0]
            found |= {trial.detector, given.removeprefix(f"{DETECTOR}=")}
    return frozenset(found)


def _is_named(name: str, key: str) -> bool:
    return name == key or name.endswith(f".{key}")


def _labels(asked: Told) -> list[str]:
    return [f"{key}={','.join(sorted(values))}" for key, values in asked.items()]


def _shown(plan: FrozenPlan) -> list[str]:
    typed = [f"{key}={','.join(values)}" for key, values in _in_order(plan.words, label_of).items()]
    return typed or [trial.level for trial in plan.trials]
