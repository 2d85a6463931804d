"""One composition for many trials: those that differ in plain values alone take it with these set."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from fl3d.config.values import check_value, is_named, names_in
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config

Resolve = Callable[[DictConfig], Config]


class Shared:
    """A composition, resolved once.

    Composing takes a seventh of a second, and resolving a fiftieth. A value that nothing else in the config reads
    (``${...}``) is set beside what the trials share; only where something does, all is resolved anew.

    Args:
        config: composed.
        resolve: makes plain values of it.
    """

    def __init__(self, config: DictConfig, resolve: Resolve) -> None:
        self._config = config
        self._resolve = resolve
        raw = {key: value for key, value in config.items_ex(resolve=False) if key != "hydra"}
        self._names = names_in(OmegaConf.to_container(OmegaConf.create(raw), resolve=False))
        self._sections: dict[tuple[str, str], Any] = {}  # by name and content
        try:
            self._resolved: Config | None = resolve(config)
        except ConfigError:  # of a value that each trial overrules, perhaps
            self._resolved = None

    def having(self, values: Sequence[Override]) -> Config:
        """The resolved config with plain values set; what they do not touch is shared, and not to be written to.

        Raises:
            ConfigError: see ``compose.resolve``.
        """
        changed = self._resolved
        for override in values:
            if changed is None or not self._stands_alone(override):
                return self._anew(values)
            changed = _with(changed, override.key_or_group.split("."), override.value())
        if changed is None:
            return self._anew(values)
        for override in values:
            check_value(override.key_or_group, changed, self._names)
        return self._with_sections(changed, values)

    def _with_sections(self, config: Config, values: Sequence[Override]) -> Config:
        """The config with sections of others where values made them equal: each is kept once."""
        for name in {override.key_or_group.partition(".")[0] for override in values}:
            config[name] = self._sections.setdefault((name, repr(config[name])), config[name])
        return config

    def _stands_alone(self, override: Override) -> bool:
        """Whether a value is text as it stands, and nothing else in the config reads it."""
        value = override.value()
        is_plain = not isinstance(value, str) or ("${" not in value and value != "???")
        return is_plain and not is_named(override.key_or_group, self._names)

    def _anew(self, values: Sequence[Override]) -> Config:
        config = copy.deepcopy(self._config)
        for override in values:
            OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
        return self._resolve(config)


def _with(config: Mapping[str, Any], parts: Sequence[str], value: Any) -> Config:
    """A nested config with one value changed; everything else is the same objects."""
    first, *rest = parts
    return {**config, first: _with(config[first], rest, value) if rest else value}
