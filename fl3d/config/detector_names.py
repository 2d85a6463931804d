"""``detector=3D-FCN``: a detector may be named as tables name it, wherever its YAML's name is meant."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from fl3d.config.objects import locate
from fl3d.config.places import CONF, own_folders
from fl3d.core.errors import ConfigError

KEY = "detector="


def spell_out_detectors(words: Sequence[str]) -> list[str]:
    """Words of a command line with the names of detectors' YAMLs; what is none stays as it is.

    Args:
        words: options and overrides, as typed; of ``detector=a,b`` each is looked at.
    """
    return [_spelled(word) if word.startswith(KEY) else word for word in words]


def _spelled(word: str) -> str:
    options = {file.stem: file for place in (CONF, *own_folders()) for file in _files(place)}
    given = word.removeprefix(KEY).split(",")
    if all(name.strip() in options for name in given) or any(sign in word for sign in "([{'\"$"):
        return word
    # A detector's plain YAML goes before variants of it, such as voxelnet before voxelnet_people.
    longest_first = sorted(options, key=len, reverse=True)
    shown = {_shown(options[name]).lower(): name for name in longest_first}
    return KEY + ",".join(
        name if name.strip() in options else shown.get(name.strip().lower(), name) for name in given
    )


def _files(place: Path) -> list[Path]:
    return sorted((place / "detector").glob("*.yaml"))


def _shown(file: Path) -> str:
    """What tables call the detector of a YAML; empty where the YAML does not tell."""
    try:
        told: Any = OmegaConf.to_container(OmegaConf.load(file), resolve=False)
        section = told["detector"]
        name = section.get("name") or getattr(locate(section["_target_"], file.name), "NAME", "")
    except (
        ConfigError,
        OSError,
        KeyError,
        TypeError,
        AttributeError,
        YAMLError,
        OmegaConfBaseException,
    ):
        return ""
    return str(name)
