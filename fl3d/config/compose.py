"""Compose and resolve configs, as Hydra's command line does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override, OverrideType
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from fl3d.config.checks import check_overrides
from fl3d.config.hydra_app import FAILURES, composed, for_hydra, hydra_says, hydra_session, searched
from fl3d.config.overrides import chooses_group, parse, typed_words
from fl3d.config.places import CONF, MAIN
from fl3d.config.shared import Shared
from fl3d.config.values import check_launcher, check_values
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config

__all__ = ["CONF", "Multirun", "compose_config", "multirun", "multirun_of", "resolve", "section"]


def compose_config(overrides: Sequence[str]) -> Config:
    """Compose and resolve a config as the command line would.

    Args:
        overrides: in Hydra's grammar, such as ``detector=voxelnet`` or ``loss.gamma=2``.

    Raises:
        ConfigError: a group, option or key that does not exist (the message lists those that do), or a value that
            cannot be.
    """
    check_overrides(overrides)
    with hydra_session():
        return resolve(composed(overrides))


def resolve(config: DictConfig) -> Config:
    """A composed config as plain values, without Hydra's own node.

    Raises:
        ConfigError: a value is missing or cannot be, an interpolation cannot be resolved, or nothing reads a key.
    """
    plain = OmegaConf.create({k: v for k, v in config.items_ex(resolve=False) if k != "hydra"})
    try:
        container = OmegaConf.to_container(plain, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ConfigError(hydra_says(error)) from None
    assert isinstance(container, dict)
    resolved = {str(key): value for key, value in container.items()}
    check_values(resolved, OmegaConf.to_container(plain, resolve=False))
    return resolved


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
    words = searched(for_hydra(overrides))
    with hydra_session():
        loader = GlobalHydra.instance().config_loader()
        try:
            master = loader.load_configuration(MAIN, words, RunMode.MULTIRUN)
        except FAILURES as error:
            raise ConfigError(hydra_says(error)) from None
    return multirun_of(loader, master, task_words(master.hydra))


def task_words(hydra: Any) -> list[str]:
    """The words of a trial or a sweep, as Hydra keeps them; ``${...}`` in them stays as it was typed."""
    words = OmegaConf.to_container(hydra.overrides.task, resolve=False)
    assert isinstance(words, list)
    return [str(word) for word in words]


def multirun_of(loader: ConfigLoader, master: DictConfig, arguments: list[str]) -> Multirun:
    """The same, from what Hydra hands to a sweeper."""
    bases: dict[tuple[str, ...], Shared] = {}

    def compose_trial(overrides: Sequence[str]) -> Config:
        first, last = _shared_and_own(overrides, master)
        try:
            if first not in bases:
                bases[first] = Shared(loader.load_sweep_config(master, for_hydra(first)), resolve)
            return bases[first].having(last)
        except FAILURES as error:
            raise ConfigError(hydra_says(error)) from None

    sweeper, launcher = (section(master.hydra, name) for name in ("sweeper", "launcher"))
    try:
        base = resolve(master)
    except ConfigError:  # it may read what is swept; what is wrong for all trials is raised again
        base = compose_trial(
            [typed_words(word)[0] for word in map(parse, arguments) if not word.is_interval_sweep()]
        )
    return Multirun(sweeper, launcher, arguments, base, compose_trial)


def _shared_and_own(
    overrides: Sequence[str], master: DictConfig
) -> tuple[tuple[str, ...], list[Override]]:
    """Overrides that a composition is made of, and plain values that can be set in it afterwards.

    Hydra chooses groups first, wherever they stand, and then sets keys in the order of the words. So what is set
    afterwards are the plain values behind which no other key comes.
    """
    first: list[str] = []
    last: list[Override] = []
    is_tail = True
    for line in reversed(overrides):
        override = parse(line)
        if is_tail and _is_plain_value(override, master):
            last.append(override)
            continue
        first.append(line)
        is_tail = is_tail and chooses_group(override) and not override.is_delete()
    return tuple(reversed(first)), last[::-1]


def _is_plain_value(override: Override, master: DictConfig) -> bool:
    """Whether an override only sets a number, text or the like that the config has already: no group, no new key."""
    if (
        override.is_sweep_override()
        or override.type is not OverrideType.CHANGE
        or override.package is not None
        or chooses_group(override)
    ):
        return False
    found = OmegaConf.select(master, override.key_or_group, throw_on_resolution_failure=False)
    has_key = found is not None and not OmegaConf.is_config(found)
    return has_key and isinstance(override.value(), int | float | bool | str)


def section(hydra: Any, name: str) -> Config:
    """A section of Hydra's own config, such as ``launcher``, resolved.

    Raises:
        ConfigError: it is none, or an interpolation in it cannot be resolved.
    """
    try:
        found = hydra[name]
        container = (
            OmegaConf.to_container(found, resolve=True) if OmegaConf.is_config(found) else found
        )
    except OmegaConfBaseException as error:
        raise ConfigError(hydra_says(error)) from None
    if not isinstance(container, Mapping) or "_target_" not in container:
        raise ConfigError(
            f"hydra.{name}: {'null' if container is None else container}, but it is a section with a _target_; "
            f"choose one by hydra/{name}=NAME"
        )
    named = {str(key): value for key, value in container.items()}
    if name == "launcher":
        check_launcher(named)
    if not isinstance(named.get("params", {}), Mapping):
        given = "null" if named["params"] is None else named["params"]
        raise ConfigError(f"hydra.{name}.params: {given}, but it holds swept values by key")
    return named
