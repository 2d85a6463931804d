"""A trial's detector, as a plan sees it: a network that fl3d trains, or a program that a command runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from fl3d.config.objects import locate
from fl3d.config.places import own_base
from fl3d.config.settings import read_stage_settings
from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError
from fl3d.core.nested import leaves
from fl3d.core.records import Config, Stage
from fl3d.detectors.base import Detector
from fl3d.inference.precision import check_precision
from fl3d.sweep.networks import Networks
from fl3d.sweep.plan import DataInfo, DetectorInfo
from fl3d.training.command import Command, command_of, is_command
from fl3d.training.output import compiled
from fl3d.training.program import read_program
from fl3d.training.trainer import VERSION as TRAINER_VERSION


class Planned(ABC):
    """What a plan needs of a trial's detector.

    Attributes:
        config: of the trial; what has to be found out beforehand is in it.
        trainer_version: of what trains it; part of a stage's identity.
    """

    config: Config
    trainer_version: int

    @abstractmethod
    def info(self, data: DataInfo) -> DetectorInfo:
        """Its name, version and stages.

        Raises:
            ConfigError: the data lack what it reads.
        """

    @abstractmethod
    def check(self) -> None:
        """Refuse a trial's config that would fail later.

        Raises:
            ConfigError: naming the key.
        """

    @abstractmethod
    def check_stage(self, stage: Stage, device: str) -> None:
        """Refuse a stage that would fail later.

        Args:
            stage: of the trial.
            device: torch's name of the one it runs on.

        Raises:
            ConfigError: naming the key.
        """

    @abstractmethod
    def unused(self, values: dict[str, Any]) -> str:
        """Why trials with these differing values, by key, are one training; empty: that is as it may be."""


def planned(config: Config) -> Planned:
    """The detector of a trial.

    Raises:
        ConfigError: it cannot be found.
    """
    if not is_command(config):
        return _Network(config)
    return _Imported(config) if config["detector"].get("imported") else _Program(config)


_networks = Networks()  # of this process


class _Network(Planned):
    """A subclass of ``Detector``, trained in a process of fl3d's."""

    trainer_version = TRAINER_VERSION

    def __init__(self, config: Config) -> None:
        self.config = config

    def info(self, data: DataInfo) -> DetectorInfo:
        """What a 2D detector found belongs to its version where it reads that."""
        kind: Any = locate(self.config["detector"]["_target_"], "detector._target_")
        version: object = kind.VERSION
        if kind.IMAGE_BOXES:
            if data.image_digest is None:
                raise ConfigError(
                    f"detector: {kind.NAME} needs 2D boxes, rgb_detections/rgb_detection_{{train,val}}.txt in data.root"
                )
            version = [kind.VERSION, data.image_digest]
        return DetectorInfo(kind.NAME, version, kind.STAGES)

    def check(self) -> None:
        """Build it, its optimiser and its augmentation."""
        detector = _networks.network(self.config)
        _networks.check_training(self.config)
        if self.config["augment"] is not None and not detector.AUGMENTED:
            raise ConfigError(
                f"augment: {detector.NAME} has its own in its YAML; augment must be null"
            )

    def check_stage(self, stage: Stage, device: str) -> None:
        """Build the stage's network."""
        settings = read_stage_settings(stage.config)
        check_precision(settings.precision, device)
        detector = self._built(stage)
        if settings.compile:
            _networks.check_compiled(stage.config)
        frozen = [
            name for name, parameter in detector.named_parameters() if not parameter.requires_grad
        ]
        if stage.parent is None and frozen:
            part = frozen[0].partition(".")[0]
            raise ConfigError(
                f"schedule.stages: '{stage.name}' comes first, but nothing would have trained its {part}"
            )

    def _built(self, stage: Stage) -> Detector:
        """The stage's network; what the schedule changes for it may be what a class does not take."""
        try:
            return _networks.network(stage.config)
        except ConfigError as error:
            changed = self.config["schedule"]["stages"][stage.name].get("set") or {}
            keys = ", ".join(key for key, _ in leaves(changed))
            if not keys:
                raise
            raise ConfigError(
                f"{error}; schedule.stages.{stage.name} sets {keys}: if that is not for this detector, choose a "
                "schedule without it, such as schedule=from_scratch"
            ) from None

    def unused(self, values: dict[str, Any]) -> str:
        """Keys that cannot change a result may differ."""
        return ""


class _Program(Planned):
    """A command, see ``docs/command_detector.md``."""

    trainer_version = 0  # fl3d's trainer has no part in it

    def __init__(self, config: Config) -> None:
        section = config["detector"]
        compiled(command_of(section).progress)
        found = _program(digest(section["program"]), own_base(), section["program"])
        self.config = {**config, "detector": {**section, "program": found}}

    def info(self, data: DataInfo) -> DetectorInfo:
        """Its stages are those of its schedule."""
        stages = tuple(self.config["schedule"]["stages"])
        return DetectorInfo(self.config["detector"]["name"], Command.VERSION, stages)

    def check(self) -> None:
        """Refuse keys of the schedule that no program was told of."""
        keys = [key for key, _ in leaves(self.config)]
        keys += ["schedule.stage.epochs", "schedule.stage.lr_factor"]  # of whichever stage it is
        first = True
        for name, own in self.config["schedule"]["stages"].items():
            if own is None:
                continue
            section = {**self.config["detector"], **(own.get("set") or {}).get("detector", {})}
            command_of(section).check(_with_sections(keys), name, has_parent=not first)
            first = False

    def check_stage(self, stage: Stage, device: str) -> None:
        """All is checked of the trial."""

    def unused(self, values: dict[str, Any]) -> str:
        """Values that no command is given cannot be compared."""
        names = " and ".join(values)
        places = ", ".join(f"{{{name}}}" for name in values)
        return (
            f"{names}: swept, but no stage's command has {places}, so that its values would be one and the same "
            "training; add it to detector.run"
        )


class _Imported(Planned):
    """Results that were there before, see ``sweep.imported``: nothing is run."""

    trainer_version = 0

    def __init__(self, config: Config) -> None:
        self.config = config

    def info(self, data: DataInfo) -> DetectorInfo:
        """It has one stage, which is done."""
        stages = tuple(self.config["schedule"]["stages"])
        return DetectorInfo(self.config["detector"]["name"], Command.VERSION, stages)

    def check(self) -> None:
        """All was checked when it was found."""

    def check_stage(self, stage: Stage, device: str) -> None:
        """All was checked when it was found."""

    def unused(self, values: dict[str, Any]) -> str:
        """Equal files were refused when they were found."""
        return ""


def _with_sections(keys: list[str]) -> list[str]:
    """Dotted keys, and those of the sections that hold them."""
    parts = [key.split(".") for key in keys]
    return list(dict.fromkeys(".".join(p[:n]) for p in parts for n in range(1, len(p) + 1)))


_programs: dict[tuple[str, Path], dict[str, Any]] = {}


def _program(asked: str, base: Path, section: dict[str, Any]) -> dict[str, Any]:
    """A program's digest, taken once in a process: all trials of a sweep are of one and the same."""
    if (asked, base) not in _programs:
        _programs[asked, base] = read_program(section, base)
    return _programs[asked, base]
