"""The one place that starts Hydra: one composition, and what its errors say in a sentence."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from fl3d.config import places
from fl3d.config.overrides import chooses_group, parse
from fl3d.core.errors import ConfigError

HYDRAS = (HydraException, OmegaConfBaseException, YAMLError)  # errors that are nobody else's
# What composing may end with; the plain ones are Hydra's too, such as ValueError for a group's null.
FAILURES = (
    *HYDRAS,
    ValueError,
    TypeError,
    AttributeError,
    KeyError,
    AssertionError,
)


@contextmanager
def hydra_session() -> Iterator[None]:
    """Hydra's global state, made for one composition; inside a Hydra application its own is put aside."""
    outer = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(places.CONF), version_base="1.3"):
            yield
    finally:
        GlobalHydra.instance().clear()
        if outer is not None:
            GlobalHydra.instance().initialize(outer)


def composed(overrides: Sequence[str], with_hydra: bool = False) -> DictConfig:
    """Compose a config within a ``hydra_session``; nothing in it is resolved.

    Args:
        overrides: in Hydra's grammar.
        with_hydra: whether Hydra's own section is kept.

    Raises:
        ConfigError: what Hydra says, in a sentence.
    """
    try:
        return compose(
            places.MAIN, overrides=searched(for_hydra(overrides)), return_hydra_config=with_hydra
        )
    except FAILURES as error:
        raise ConfigError(hydra_says(error)) from None


def for_hydra(overrides: Sequence[str]) -> list[str]:
    """Overrides as Hydra takes them: it has no null for a group (``loss=null``), but leaves one out (``~loss``)."""
    parsed = [parse(line) for line in overrides]
    last = {
        one.key_or_group: n for n, one in enumerate(parsed) if places.is_group(one.key_or_group)
    }
    words = []
    for number, (line, override) in enumerate(zip(overrides, parsed, strict=True)):
        if not chooses_group(override) or override.is_delete() or override.value() is not None:
            words.append(line)
        elif last[override.key_or_group] == number and not override.is_add():
            words.append(f"~{override.get_key_element()}")
    return words


def searched(overrides: Sequence[str]) -> list[str]:
    """Overrides, with the folders of the user's own."""
    own = places.own_folders()
    if not own:
        return list(overrides)
    folders = ",".join(f"'{_escaped(f'file://{folder}')}'" for folder in own)
    return [f"hydra.searchpath=[{folders}]", *overrides]


def _escaped(text: str) -> str:
    """A text within single quotes of Hydra's grammar."""
    return text.replace("\\'", "\\\\'").replace("'", "\\'")


def hydra_says(error: Exception) -> str:
    """What is wrong in one line, also where Hydra's own message is empty or says only where it happened."""
    text = _one_line(str(error))
    cause = error.__cause__
    if cause is None:
        return f"{_where(error)}{text or type(error).__name__}"
    reason = str(cause).strip().partition("\n")[0]
    if text:  # such as: Error merging override hydra.mode=FOO
        return f"{text}: {reason}" if reason and reason not in text else text
    return (
        f"{_where(cause)}{reason}; ${{...}} is a value of the config (OmegaConf's), which this is not: "
        "write \\${ where the characters are meant, and \\${{NAME}} for a variable of bash in a command"
    )


def _where(error: BaseException) -> str:
    """The key that an error of OmegaConf's is about, for the front of a message."""
    key = getattr(error, "full_key", None)
    return f"{key}: " if key else ""


def _one_line(text: str) -> str:
    """The lines of a message as one; where Hydra looked, and OmegaConf's notes, are left out."""
    lines = [line.strip() for line in text.split("Config search path:")[0].splitlines()]
    kept = [line for line in lines if line and not re.match(r"(full_key|object_type)[:=]", line)]
    joined = ""
    for line in kept:
        joined += f"{_joint(joined)}{line}" if joined else line
    return joined


def _joint(before: str) -> str:
    """What goes between two lines."""
    return " " if before.endswith((":", ".", ",", ";")) else ", "
