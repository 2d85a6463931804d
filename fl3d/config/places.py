"""Where configs lie: fl3d's own, and folders of the user's."""

from __future__ import annotations

import os
from pathlib import Path

from fl3d.config.modules import make_importable
from fl3d.core.errors import ConfigError
from fl3d.core.shipped import shipped

CONF = shipped("conf")
PUBLISHED = shipped("results")  # what the project publishes
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


def own_file(group: str, option: object) -> Path | None:
    """The user's file of a group's option; None: it is fl3d's, or no option at all."""
    if option not in options_of(group):
        return None
    files = (folder / group / f"{option}.yaml" for folder in _OWN)
    return next((file for file in files if file.is_file()), None)


def own_base() -> Path:
    """What a relative folder in a user's YAML is relative to: the folder of the YAMLs, else the working folder."""
    return _OWN[0] if _OWN else Path.cwd()


def config_folders() -> tuple[Path, ...]:
    """All folders that hold configs, fl3d's first."""
    return (CONF, *_OWN)


def groups() -> set[str]:
    """Config groups: folders that hold YAMLs, such as ``detector`` or ``hydra/launcher``."""
    found = set()
    for place in config_folders():
        for folder, _, files in os.walk(place, followlinks=True):  # conf/sweep is a link to sweeps/
            if any(file.endswith(".yaml") for file in files):
                found.add(Path(folder).relative_to(place).as_posix())
    return found - {"."}


def is_group(key: str) -> bool:
    """Whether a key names a config group."""
    return any((place / key).is_dir() for place in config_folders())


def options_of(group: str) -> list[str]:
    """What can be chosen of a group, as it is typed."""
    return sorted(
        {
            path.relative_to(place / group).with_suffix("").as_posix()
            for place in config_folders()
            for path in (place / group).rglob("*.yaml")
        }
    )
