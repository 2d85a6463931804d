"""Swept values as a sweep file gives them: ``hydra.sweeper.params``."""

from __future__ import annotations

from collections.abc import Mapping

from fl3d.core.errors import ConfigError


def check_params(params: object) -> None:
    """Refuse what is no mapping of keys to values.

    Raises:
        ConfigError: saying what it is.
    """
    if not isinstance(params, Mapping):
        shown = "null" if params is None else params
        raise ConfigError(
            f"hydra.sweeper.params: {shown} is no mapping of keys to values, such as {{loss.gamma: '0,2'}}; without "
            "any it is {}"
        )
    for key, value in params.items():
        if value is None:
            raise ConfigError(
                f"hydra.sweeper.params: {key}: null says nothing; give values as Hydra reads them, such as 'null,2'"
            )
