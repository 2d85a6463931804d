"""The only module that knows Hydra: compose and resolve configs, and build objects from them."""

from __future__ import annotations

import copy
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType, QuotedString
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from fl3d.config.objects import make_importable
from fl3d.core.errors import ConfigError, options
from fl3d.core.records import Config

CONF = Path(__file__).resolve().parents[2] / "conf"
MAIN = "config"
# Folders of the user's own YAMLs, see ``search_also``. A process has one command line, and so one list of them.
_OWN: list[Path] = []


def search_also(folder: Path) -> None:
    """Look for groups in a folder of the user's too, and for Python modules.

    Args:
        folder: holds ``detector/NAME.yaml``, ``sweep/NAME.yaml`` and the like, and modules that ``_target_`` names.

    Raises:
        ConfigError: there is no such folder, or a file in it has the place of one of fl3d's.
    """
    path = folder.resolve()
    if not path.is_dir():
        raise ConfigError(f"--config-dir {folder}: no such folder")
    for file in sorted(path.glob("*/**/*.yaml")):
        name = file.relative_to(path)
        if (CONF / name).exists():
            raise ConfigError(f"{file}: fl3d has a {name} of its own; give yours another name")
    if path not in _OWN:
        _OWN.append(path)
        make_importable([str(path)])


def own_folders() -> tuple[Path, ...]:
    """The folders of the user's own, as they were added."""
    return tuple(_OWN)


def own_base() -> Path:
    """What a relative folder in a user's YAML is relative to: the folder of the YAMLs, else the working folder."""
    return _OWN[0] if _OWN else Path.cwd()


def _searched(overrides: Sequence[str]) -> list[str]:
    """Overrides, with the folders of the user's own."""
    if not _OWN:
        return list(overrides)
    folders = ",".join(f"'file://{folder}'" for folder in _OWN)
    return [f"hydra.searchpath=[{folders}]", *overrides]


def compose_config(overrides: Sequence[str]) -> Config:
    """Compose and resolve a config as the command line would.

    Args:
        overrides: in Hydra's grammar, such as ``detector=voxelnet`` or ``loss.gamma=2``.

    Raises:
        ConfigError: a group, option or key that does not exist (the message lists those that do).
    """
    check_overrides(overrides)
    with _hydra():
        return resolve(_compose(overrides))


def resolve(config: DictConfig) -> Config:
    """A composed config as plain values, without Hydra's own node.

    Raises:
        ConfigError: a value is missing, or an interpolation cannot be resolved.
    """
    plain = OmegaConf.create({k: v for k, v in config.items_ex(resolve=False) if k != "hydra"})
    try:
        container = OmegaConf.to_container(plain, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ConfigError(str(error).splitlines()[0]) from None
    assert isinstance(container, dict)
    return {str(key): value for key, value in container.items()}


@dataclass(frozen=True)
class Multirun:
    """What the command line of a sweep says.

    Args:
        sweeper: section of Hydra's config, with its ``_target_``.
        launcher: likewise.
        arguments: overrides of the task, swept ones among them.
        base: resolved config without what is swept.
        compose: makes a resolved config of overrides.
    """

    sweeper: Config
    launcher: Config
    arguments: list[str]
    base: Config
    compose: Callable[[Sequence[str]], Config]


def multirun(overrides: Sequence[str]) -> Multirun:
    """Read the command line of a sweep as Hydra's ``--multirun`` does, without running it.

    Raises:
        ConfigError: a group, option or key that does not exist.
    """
    check_overrides(overrides)
    with _hydra():
        loader = GlobalHydra.instance().config_loader()
        try:
            composed = loader.load_configuration(MAIN, _searched(overrides), RunMode.MULTIRUN)
        except HydraException as error:
            raise ConfigError(hydra_says(error)) from None
    return multirun_of(loader, composed, list(composed.hydra.overrides.task))


def multirun_of(loader: ConfigLoader, composed: DictConfig, arguments: list[str]) -> Multirun:
    """The same, from what Hydra hands to a sweeper."""
    bases: dict[tuple[str, ...], DictConfig] = {}

    def compose_trial(overrides: Sequence[str]) -> Config:
        # Composing takes a seventh of a second; trials that differ in plain values alone share one composition.
        plain = [line for line in overrides if _is_plain_value(_parse(line), composed)]
        rest = tuple(line for line in overrides if line not in plain)
        try:
            if rest not in bases:
                bases[rest] = loader.load_sweep_config(composed, list(rest))
            config = copy.deepcopy(bases[rest])
            for line in plain:
                override = _parse(line)
                OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
            return resolve(config)
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(hydra_says(error)) from None

    sweeper, launcher = (section(composed.hydra, name) for name in ("sweeper", "launcher"))
    return Multirun(sweeper, launcher, arguments, resolve(composed), compose_trial)


def _is_plain_value(override: Override, composed: DictConfig) -> bool:
    """Whether an override only sets a number, text or the like that the config has already: no group, no new key."""
    if (
        override.is_sweep_override()
        or override.type is not OverrideType.CHANGE
        or override.package is not None
    ):
        return False
    is_group = any((place / override.key_or_group).is_dir() for place in (CONF, *_OWN))
    found = OmegaConf.select(composed, override.key_or_group, throw_on_resolution_failure=False)
    value = override.value()
    has_key = found is not None and not OmegaConf.is_config(found)
    return not is_group and has_key and isinstance(value, int | float | bool | str)


def values_by_key(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """What overrides say, swept or not, as plain values: ``seed=0,1`` -> ``{"seed": [0, 1]}``.

    Raises:
        ConfigError: an interval, whose values cannot be listed.
    """
    parsed = [_parse(line) for line in arguments]
    return {
        override.key_or_group: _plain_values(override)
        for override in parsed
        if not override.is_delete()
    }


def is_interval(line: str) -> bool:
    """Whether an override sweeps an interval, as a study does."""
    override = _parse(line)
    return override.is_sweep_override() and not override.is_discrete_sweep()


def _plain_values(override: Override) -> list[Any]:
    if not override.is_sweep_override():
        return [_plain(override.value())]
    try:
        return [_plain(value) for value in override.sweep_iterator()]
    except HydraException:
        raise ConfigError(
            f"'{override.input_line}': a grid needs values that can be listed, such as 0,1,2 or range(0,3); "
            "to search an interval add hydra/sweeper=optuna"
        ) from None


def _plain(value: Any) -> Any:
    """A parsed value without Hydra's own classes."""
    if isinstance(value, QuotedString):
        return value.text
    if isinstance(value, Mapping):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value


def section(hydra: Any, name: str) -> Config:
    """A section of Hydra's own config, such as ``launcher``, resolved."""
    container = OmegaConf.to_container(hydra[name], resolve=True)
    assert isinstance(container, dict)
    return {str(key): value for key, value in container.items()}


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse misspelt groups, options and keys, saying which there are.

    Raises:
        ConfigError: the first override that does not fit.
    """
    parsed = [_parse(line) for line in overrides]
    groups = set().union(*(_groups(place) for place in (CONF, *_OWN)))
    chosen: list[str] = []
    keys: list[tuple[str, str]] = []
    for override in parsed:
        key = override.key_or_group
        if key.startswith("hydra"):
            continue
        if key in groups:
            for option in _choices(override.value()):
                _check_option(key, option)
            first = _choices(override.value())[0]
            plus = "+" if override.is_add() else ""
            chosen.append(f"{plus}{key}={first}")
        elif not override.is_add():
            keys.append((override.input_line or key, key))
    if keys:
        with _hydra():
            base = _compose(chosen)
            for line, key in keys:
                _check_key(base, key, line, groups)


def _groups(place: Path) -> set[str]:
    """Folders below one that hold YAMLs."""
    walked = os.walk(place, followlinks=True)  # conf/sweep is a link to sweeps/
    found = {
        Path(folder).relative_to(place).as_posix()
        for folder, _, files in walked
        if any(file.endswith(".yaml") for file in files)
    }
    return found - {"."}


def _parse(line: str) -> Override:
    try:
        return OverridesParser.create().parse_override(line)
    except HydraException as error:
        raise ConfigError(
            f"'{line}' is not KEY=VALUE in Hydra's grammar: {str(error).splitlines()[0]}{_quoted(line)}"
        ) from None


def _quoted(line: str) -> str:
    """How to type a value that holds what Hydra's grammar does not, such as blanks, brackets, ``=`` or ``é``."""
    key, is_assigned, value = line.partition("=")
    if not is_assigned or not value or value[0] in "[{\"'":  # a list, a dict or quoted already
        return ""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    typed = shlex.quote(f'{key}="{escaped}"')
    return f". To give it as text, quote it twice: {typed}"


def _choices(value: Any) -> list[str]:
    choices = getattr(value, "list", None)  # a sweep such as detector=fcn3d,voxelnet
    return [str(v) for v in choices] if choices is not None else [str(value)]


def _check_option(group: str, option: str) -> None:
    places = (CONF, *_OWN)
    present = [
        path.relative_to(place / group).with_suffix("").as_posix()
        for place in places
        for path in (place / group).rglob("*.yaml")
    ]
    if option not in present:
        own = "".join(f" or {place / group}" for place in _OWN)
        raise ConfigError(
            f"{group}={option}: no such file in conf/{group}{own}. {options(option, present)}"
        )


def _check_key(base: DictConfig, key: str, line: str, groups: set[str]) -> None:
    node: Any = base
    parts = key.split(".")
    for depth, part in enumerate(parts):
        if not OmegaConf.is_dict(node) or part not in node:
            where = ".".join(parts[:depth])
            present = [str(k) for k in node] if OmegaConf.is_dict(node) else []
            if depth == 0:
                raise ConfigError(
                    f"{line}: no key or group '{part}'. {options(part, {*present, *groups} - {'hydra'})}"
                )
            raise ConfigError(f"{line}: no key '{part}' in '{where}'. {options(part, present)}")
        node = OmegaConf.select(
            base, ".".join(parts[: depth + 1]), throw_on_resolution_failure=False
        )


def _compose(overrides: Sequence[str]) -> DictConfig:
    try:
        return compose(MAIN, overrides=_searched(overrides), return_hydra_config=False)
    except HydraException as error:
        raise ConfigError(hydra_says(error)) from None


def hydra_says(error: HydraException | OmegaConfBaseException) -> str:
    """What is wrong, also where Hydra's own message is empty: a ``${`` in a text that is none of OmegaConf's."""
    text = str(error).strip()
    cause = error.__cause__
    if text or cause is None:
        return text or type(error).__name__
    key = getattr(cause, "full_key", None)
    where = f"{key}: " if key else ""
    return (
        f"{where}{str(cause).splitlines()[0]}; ${{...}} is a value of the config (OmegaConf's), which this is not: "
        "write \\${ where the characters are meant, and \\${{NAME}} for a variable of bash in a command"
    )


@contextmanager
def _hydra() -> Iterator[None]:
    """Hydra's global state, made for one composition; inside a Hydra application its own is put aside."""
    outer = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            yield
    finally:
        GlobalHydra.instance().clear()
        if outer is not None:
            GlobalHydra.instance().initialize(outer)
