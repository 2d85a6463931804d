"""The command line of a stage: its places and their values, and what a parent or an interrupted start adds to it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fl3d.core.errors import CheckpointError
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec
from fl3d.training.command import Command
from fl3d.training.result_folders import last_by_number
from fl3d.training.templates import Bash, Line, fill, fill_text, shell_text


class CommandLine:
    """What is started for a stage, and where.

    Args:
        command: of the stage's detector.
        folder: of the stage.
        spec: of the stage.

    Attributes:
        values: of all places that the command may have.
        resumed: the program's own checkpoint that this start goes on from; None: from its beginning.

    Raises:
        CheckpointError: the stage goes on from another that has not ended, or has left no checkpoint.
    """

    def __init__(self, command: Command, folder: RunFolder, spec: Spec) -> None:
        self.command = command
        self.folder = folder
        self.stage = spec.stage
        self.values = _values(folder, spec)
        self.resumed: Path | None = None
        if self.stage.parent is not None:
            self._add_parent(folder.beside(self.stage.parent))

    @property
    def cwd(self) -> Path:
        """Folder that it is started in."""
        return Path(fill_text(self.command.cwd, self.values))

    @property
    def env(self) -> dict[str, str]:
        """What is added to the environment."""
        return {name: fill_text(text, self.values) for name, text in self.command.env.items()}

    def resume(self) -> None:
        """Go on from the newest checkpoint that an interrupted start has left, where the program can."""
        if self.command.checkpoint is not None and self.command.resume:
            self.resumed = self._newest_checkpoint(self.folder)
            self.values["checkpoint"] = str(self.resumed)

    def arguments(self) -> list[str]:
        """The command, with what is added of a parent and of an interrupted start."""
        added = {
            "from_parent": self._filled(self.command.from_parent, self.stage.parent is not None),
            "resume": self._filled(self.command.resume, self.resumed is not None),
        }
        named = self.command.named()
        run = fill(self.command.run, self.values | {name: added[name] for name in named})
        behind = [line for name, line in added.items() if line and name not in named]
        if isinstance(run, str):
            text = " ".join([run.rstrip(), *map(shell_text, behind)])
            return ["bash", "-euo", "pipefail", "-c", text]
        return [*run, *(word for line in behind for word in line)]

    def _filled(self, line: Line, is_added: bool) -> Line:
        """What is added to the command: nothing where there is none to go on from."""
        if not is_added or not line:
            return ()
        filled = fill(line, self.values)
        return Bash(filled) if isinstance(filled, str) else filled

    def _add_parent(self, parent: RunFolder) -> None:
        """Give the places that name the stage which this one goes on from their values."""
        if not parent.is_done:
            raise CheckpointError(
                f"{parent.path}: it has not ended, and this stage goes on from it"
            )
        self.values["parent"] = str(parent.work)
        if self.command.checkpoint is not None:
            self.values["parent_checkpoint"] = self._parents_checkpoint(parent)

    def _parents_checkpoint(self, parent: RunFolder) -> str:
        found = self._newest_checkpoint(parent)
        if found is None and "parent_checkpoint" in self.command.places(has_parent=True):
            pattern = fill_text(self.command.checkpoint or "", self.values)
            raise CheckpointError(
                f"{parent.work}: no file fits detector.checkpoint, {pattern}, of the stage that this one goes on from"
            )
        return str(found)

    def _newest_checkpoint(self, folder: RunFolder) -> Path | None:
        pattern = fill_text(self.command.checkpoint or "", self.values)
        return last_by_number(pattern, folder.work)


def _values(folder: RunFolder, spec: Spec) -> dict[str, Any]:
    """Values of the places that every stage has."""
    stage = spec.stage
    section = stage.config["detector"]
    values: dict[str, Any] = dict(_sections(stage.config)) | dict(section["places"])
    return values | {
        "folder": str(folder.work),
        "program": section["program"]["folder"],
        "python": sys.executable,
        "key": stage.key,
        "stage": stage.name,
        "data_root": str(spec.kitti().root),
        "train_split": str(folder.split("train")),
        "val_split": str(folder.split("val")),
        "epochs": stage.epochs,
        "start_epoch": stage.start_epoch,
        "end_epoch": stage.start_epoch + stage.epochs,
    }


def _sections(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Dotted keys of a nested config with their values, sections among them."""
    found: list[tuple[str, Any]] = []
    for key, value in config.items():
        found.append((f"{prefix}{key}", value))
        if isinstance(value, Mapping):
            found += _sections(value, f"{prefix}{key}.")
    return found
