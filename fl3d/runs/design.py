"""The design of a sweep: which key is compared (factor), at which values (levels), among what (groups). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fl3d.config.settings import SweepSettings
from fl3d.core.errors import ConfigError, options
from fl3d.core.records import Config, Trial

DETECTOR = "detector"
SEED = "seed"
NO_FACTOR = "default"  # the one level of a sweep that compares nothing


@dataclass(frozen=True)
class Design:
    """What a sweep compares.

    Args:
        factor: keys that are compared together.
        groups: keys whose values are told apart, each with a table of its own.
    """

    factor: tuple[str, ...]
    groups: tuple[str, ...]

    @property
    def factor_name(self) -> str:
        """Short: ``gamma``, or ``alpha, beta``."""
        return factor_name(self.factor)

    def level(self, values: Mapping[str, Any], config: Config, detector: str) -> str:
        """Label of a trial's level.

        Args:
            values: swept values by key.
            config: of the trial, for keys that are not swept.
            detector: its name in papers, which stands for the key ``detector``.

        Raises:
            ConfigError: a key of the factor that is neither swept nor in the config.
        """
        labels = {key: self._label(key, values, config, detector) for key in self.factor}
        if len(labels) < 2:
            return "".join(labels.values()) or NO_FACTOR
        return ", ".join(f"{name}={labels[key]}" for key, name in short_names(self.factor).items())

    def group(self, values: Mapping[str, Any], config: Config, detector: str) -> str:
        """Label of a trial's group; it begins with the detector, unless detectors are what is compared."""
        names = short_names(self.groups)
        parts = [] if DETECTOR in self.factor else [detector]
        for key in self.groups:
            if key != DETECTOR:
                parts.append(f"{names[key]}={self._label(key, values, config, detector)}")
        return ", ".join(parts) or "all"

    def _label(self, key: str, values: Mapping[str, Any], config: Config, detector: str) -> str:
        if key == DETECTOR:
            return detector
        if key in values:
            return label_of(values[key])
        node: Any = config
        for part in key.split("."):
            if not isinstance(node, Mapping) or part not in node:
                raise ConfigError(
                    f"sweep.factor, sweep.groups: no key '{key}'. {options(key, values)}"
                )
            node = node[part]
        return label_of(node)


def make_design(swept: Iterable[str], asked: SweepSettings) -> Design:
    """The design of a sweep.

    Args:
        swept: keys that are swept, in order.
        asked: factor and groups, where the user named them.
    """
    keys = [key for key in swept if key != SEED]
    if asked.factor:
        factor = asked.factor
    else:
        outside = asked.groups if asked.groups is not None else (DETECTOR,)
        factor = tuple(key for key in keys if key not in outside)
        if not factor and asked.groups is None and DETECTOR in keys:
            factor = (DETECTOR,)  # a sweep over detectors alone compares them
    groups = asked.groups
    if groups is None:
        groups = tuple(key for key in keys if key not in factor)
    return Design(factor, groups)


def factor_name(factor: Iterable[str]) -> str:
    """What a factor is called in tables: ``gamma``, or ``alpha, beta``."""
    return ", ".join(short_names(factor).values())


def level_text(factor: Sequence[str], level: str) -> str:
    """A level as it is told outside a table of its factor: ``gamma=0.5``."""
    return f"{factor[0].rpartition('.')[2]}={level}" if len(factor) == 1 else level


def label_of(value: Any) -> str:
    """A value as people write it: ``0.5``, ``null``, ``[0.4, 0.4]``, ``search=3 bin=0.5``."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    if isinstance(value, Mapping):
        parts = [f"{key}={label_of(item)}" for key, item in value.items() if key != "_target_"]
        kind = str(value.get("_target_", "")).rpartition(".")[2]  # an object is told by its class
        return " ".join([kind, *parts] if kind else parts)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(label_of(item) for item in value)}]"
    return str(value)


def short_names(keys: Iterable[str]) -> dict[str, str]:
    """The last part of each key, and as many before it as tell it from the others."""
    every = list(keys)
    names = {}
    for key in every:
        parts = key.split(".")
        for count in range(1, len(parts) + 1):
            name = ".".join(parts[-count:])
            if sum(other == name or other.endswith(f".{name}") for other in every) == 1:
                break
        names[key] = name
    return names


def refuse_twins(trials: Iterable[Trial]) -> None:
    """Refuse two trials that would fall on the same (group, level, seed): one would hide the other.

    Raises:
        ConfigError: naming the keys in which they differ.
    """
    seen: dict[tuple[str, str, int], Trial] = {}
    for trial in trials:
        other = seen.setdefault((trial.group, trial.level, trial.seed), trial)
        if other.key != trial.key:
            keys = [*other.values, *(key for key in trial.values if key not in other.values)]
            differing = [key for key in keys if other.values.get(key) != trial.values.get(key)]
            pair = f"'{' '.join(other.overrides)}' and '{' '.join(trial.overrides)}'"
            raise ConfigError(
                f"{pair} would both be {trial.label}: they differ in {', '.join(differing) or 'other keys'}. "
                "Name these keys in sweep.factor (they are compared) or in sweep.groups (a table each)"
            )


def refuse_lone_level(factor: Sequence[str], trials: Iterable[Trial]) -> None:
    """Refuse a factor that a user named and that has one value, where the trials differ in other keys.

    Raises:
        ConfigError: naming these keys.
    """
    every = list(trials)
    levels = {trial.level for trial in every}
    if not factor or len(levels) > 1 or len({trial.group for trial in every}) < 2:
        return
    keys = dict.fromkeys(key for trial in every for key in trial.values if key != SEED)
    told = {key: {label_of(trial.values.get(key)) for trial in every} for key in keys}
    swept = [key for key, values in told.items() if len(values) > 1]
    raise ConfigError(
        f"sweep.factor: {', '.join(factor)} has one level here ({', '.join(levels)}), so that nothing is compared. "
        f"Swept: {', '.join(swept) or 'other keys'}. Name one of them, leave sweep.factor out, or give "
        f"{factor[0]} several values"
    )


def refuse_other_design(asked: SweepSettings, factor: Sequence[str], name: str) -> None:
    """Refuse a factor that a sweep was not run with.

    Args:
        asked: as the words say now.
        factor: keys that the sweep compares.
        name: of the sweep.

    Raises:
        ConfigError: saying what it compares.
    """
    if asked.factor and set(asked.factor) != set(factor):
        raise ConfigError(
            f"sweep.factor: {name} was run to compare {', '.join(factor) or 'nothing'}, not {', '.join(asked.factor)}; "
            "leave the word out, or run the sweep with it under a sweep.name of its own"
        )


def detector_levels(
    factor: Sequence[str], trials: Iterable[tuple[Mapping[str, Any], str]]
) -> dict[str, str]:
    """Levels that are detectors, by the names that the config has for them.

    Args:
        factor: keys that are compared.
        trials: values and level of each.
    """
    if tuple(factor) != (DETECTOR,):
        return {}
    return {label_of(values[DETECTOR]): level for values, level in trials if DETECTOR in values}


def baseline_level(
    levels: Sequence[str],
    factor: Sequence[str],
    asked: Any,
    names: Mapping[str, str] | None = None,
) -> str:
    """The level that the others are held against.

    Args:
        levels: of the sweep, in its order.
        factor: keys of the factor.
        asked: ``sweep.baseline``: a value, a label, or for several keys a value of each; None: the first level.
        names: other names of levels, see ``detector_levels``.

    Raises:
        ConfigError: there is no such level.
    """
    if asked is None:
        return levels[0]
    wanted = asked_label(factor, asked)
    wanted = (names or {}).get(wanted, wanted)
    if wanted not in levels:
        raise ConfigError(f"sweep.baseline: no level '{wanted}'. {options(wanted, levels)}")
    return wanted


def asked_label(factor: Sequence[str], asked: Any) -> str:
    """Label of a level that a user named, see ``baseline_level``.

    Raises:
        ConfigError: more values than keys, or a value of a key that is not of the factor.
    """
    names = short_names(factor)
    if len(factor) > 1 and isinstance(asked, Mapping):
        _refuse_others(asked, names)
        values = [asked.get(key, asked.get(names[key])) for key in factor]
    elif len(factor) > 1 and isinstance(asked, Sequence) and not isinstance(asked, str):
        values = list(asked)
        if len(values) > len(factor):
            keys = ", ".join(factor)
            raise ConfigError(
                f"sweep.baseline: {label_of(values)} has {len(values)} values, and the sweep compares "
                f"{len(factor)} keys, {keys}: a value of each"
            )
    else:
        return label_of(asked)
    pairs = zip(names.values(), values, strict=False)
    return ", ".join(f"{name}={label_of(value)}" for name, value in pairs)


def _refuse_others(asked: Mapping[str, Any], names: Mapping[str, str]) -> None:
    """Refuse a value of a key that is not compared: it would say nothing."""
    possible = {*names, *names.values()}
    for key in asked:
        if key not in possible:
            raise ConfigError(
                f"sweep.baseline: '{key}' is no key that the sweep compares. {options(key, names)}"
            )


def in_order(levels: Iterable[str]) -> list[str]:
    """Each level once: by number where all are numbers, else as they come."""
    unique = list(dict.fromkeys(levels))
    try:
        return sorted(unique, key=float)
    except ValueError:
        return unique
