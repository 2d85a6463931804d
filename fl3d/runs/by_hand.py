"""Sweeps and trials that were typed by hand, without a name: which of them words mean.

Words find a sweep again by what it was started with, which its plan keeps; what it is called see ``by_hand_names``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from fl3d.config.detector_names import spell_out_detectors
from fl3d.config.settings import BY_HAND, Settings
from fl3d.core.errors import StoreError
from fl3d.runs.by_hand_names import Told, labels_of, told
from fl3d.runs.design import DETECTOR, SEED, label_of
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import FrozenPlan, read_plan


@dataclass(frozen=True)
class _Found:
    """A sweep that was typed by hand: its name, its plan, and when it was started last."""

    name: str
    plan: FrozenPlan
    started: float


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
    typed = [f"{key}={','.join(values)}" for key, values in labels_of(plan.words).items()]
    return typed or [trial.level for trial in plan.trials]
