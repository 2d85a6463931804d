"""What a resolved config says, typed: the rooms above pass these records on, never the dict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.core.errors import ConfigError, options
from fl3d.core.names import check_name
from fl3d.core.records import Config
from fl3d.data.classes import CARS
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import checked_size
from fl3d.evaluation.protocol import Protocol, split_metric
from fl3d.evaluation.selection import STAGES

BY_HAND = "trials"  # the name of a sweep that was given none


@dataclass(frozen=True, kw_only=True)
class DataSettings:
    """Which frames, see ``conf/data``.

    Args:
        name: in the names of results and experiments.
        root: KITTI folder, or the folder below which one is simulated; None: not given yet.
        generate: whether the simulator writes it.
        seed: of the simulated frames, and of subsets.
        train_split: file in ``ImageSets``, without its ending.
        val_split: likewise.
        train_frames: at most so many; None: all.
        val_frames: likewise.
        crop: see ``data.kitti.KittiFolder``.
        calibration: likewise.
        cloud: how clouds are read.
        image_size: (width, height) in pixels of frames that have no picture; None: by their calibration.
        cache_frames: kept in memory by each process.
        people: how many times as often as in KITTI simulated frames have people; None: as the published ones.
        mapping: folder of KITTI's mapping of frames to drives; None: ``mapping`` below ``root``.
        classes: that are detected.
    """

    name: str
    root: Path | None
    generate: bool
    seed: int
    train_split: str
    val_split: str
    train_frames: int | None
    val_frames: int | None
    crop: str
    calibration: str
    cloud: CloudFormat
    image_size: tuple[int, int] | None
    cache_frames: int
    mapping: Path | None
    people: float | None = None
    classes: tuple[str, ...] = CARS

    def folder(self, root: Path) -> KittiFolder:
        """A KITTI folder, read as the config says."""
        return KittiFolder(
            root, self.crop, self.calibration, self.cloud, self.image_size, self.classes
        )


@dataclass(frozen=True, kw_only=True)
class StoreSettings:
    """Where results are kept, see ``store`` in ``conf/config.yaml``.

    Args:
        root: folder of run folders, plans and the default store.
        uri: of another store for scores; None: a file below ``root``.
        keep_every: epochs between checkpoints whose weights are kept; None: only the last and the best.
    """

    root: Path
    uri: str | None
    keep_every: int | None


@dataclass(frozen=True, kw_only=True)
class SweepSettings:
    """What a sweep asks, see ``sweep`` in ``conf/config.yaml``.

    Args:
        name: of the sweep.
        question: one sentence, or None.
        factor: keys that are compared; empty: the swept keys other than ``detector`` and ``seed``.
        baseline: the level that the others are held against, as the user wrote it; None: the first.
        groups: keys whose values have a table each; None: the swept keys that are neither factor nor ``seed``.
        primary: metric that is named before training, such as ``3d_r40/moderate``; of several classes that is their
            mean, and ``3d_r40/moderate/Pedestrian`` one of them.
        margin: gains below it do not matter, AP.
        tables: of papers, such as ``focal_loss.last_voxelnet``.
        after: a sweep whose winner's values this one keeps; None: none.
        winner: metric that decides who wins; None: nobody does.
    """

    name: str
    question: str | None
    factor: tuple[str, ...]
    baseline: Any
    groups: tuple[str, ...] | None
    primary: str
    margin: float
    tables: tuple[str, ...]
    after: str | None
    winner: str | None

    @property
    def metric(self) -> str:
        """View and difficulty of the primary metric: ``3d/moderate``."""
        return split_metric(self.primary)[0].replace("_r40/", "/")

    @property
    def class_name(self) -> str | None:
        """Class of the primary metric, where it names one of several; None: the one class, or the mean."""
        return split_metric(self.primary)[1]

    @property
    def average(self) -> str:
        """``R11`` or ``R40``, of the primary metric."""
        return "R40" if "_r40/" in self.primary else "R11"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What all trials of a sweep share.

    Args:
        sweep: what it asks.
        data: which frames.
        store: where it is kept.
        protocol: what an AP stands for.
        profile: name of the size.
        best_among: where ``best`` looks, see ``evaluation.selection.select``.
        results: folder of tables and figures.
        device: torch's name of it.
        workers: loader processes of each stage; None: by the device.
        save_every_steps: steps between resume points within an epoch; None: none.
        part: of the sweep, or another question than it was run with, that was asked for: its results lie apart;
            empty: all of it, as it was run.
    """

    sweep: SweepSettings
    data: DataSettings
    store: StoreSettings
    protocol: Protocol
    profile: str
    best_among: str
    results: Path
    device: str
    workers: int | None
    save_every_steps: int | None
    part: str = ""

    @property
    def experiment(self) -> str:
        """Name of the sweep on these data at this size; plans know it by this."""
        return f"{self.sweep.name}-{self.folder_name}"

    @property
    def stored_as(self) -> str:
        """Name of its experiment in the store: its own, or that of all single trials typed by hand."""
        is_trial = self.sweep.name.startswith(f"{BY_HAND}.")
        return f"{BY_HAND}-{self.folder_name}" if is_trial else self.experiment

    @property
    def folder_name(self) -> str:
        """``<data>-<profile>``."""
        return f"{self.data.name}-{self.profile}"

    @property
    def results_folder(self) -> Path:
        """``<results>/<data>-<profile>``; of a part the folder ``asked/<part>`` in it."""
        whole = self.results / self.folder_name
        return whole / "asked" / self.part if self.part else whole


@dataclass(frozen=True, kw_only=True)
class StageSettings:
    """Values of a stage's own config that its trainer and its readers use by name.

    Args:
        seed: of weights, order and sampling.
        precision: see ``inference.precision``.
        compile: whether dense layers are compiled.
        batch_size: frames in a step.
        checkpoint_every: epochs between checkpoints.
        crop: see ``data.kitti.KittiFolder``.
        calibration: likewise.
        cloud: likewise.
        image_size: likewise.
        classes: that it detects.
        max_boxes: stored of each frame and class.
        min_score: of a stored box.
    """

    seed: int
    precision: str
    compile: bool
    batch_size: int
    checkpoint_every: int
    crop: str
    calibration: str
    cloud: CloudFormat
    image_size: tuple[int, int] | None
    classes: tuple[str, ...]
    max_boxes: int
    min_score: float

    def folder(self, root: Path) -> KittiFolder:
        """A KITTI folder, read as the stage reads it."""
        return KittiFolder(
            root, self.crop, self.calibration, self.cloud, self.image_size, self.classes
        )


def read_settings(config: Config) -> Settings:
    """The settings of a resolved config.

    Raises:
        ConfigError: a protocol, a metric or a selection that does not exist, or a name that no file can have.
    """
    best_among = config["selection"]["stages"]
    if best_among not in STAGES:
        raise ConfigError(f"selection.stages: {options(best_among, STAGES)}")
    protocol = Protocol(**config["protocol"], classes=tuple(config.get("classes", CARS)))
    protocol.check_classes()
    check_name("protocol.name", protocol.name)
    return Settings(
        sweep=_sweep(config["sweep"], protocol),
        data=_data(config["data"], protocol.classes),
        store=_store(config["store"]),
        protocol=protocol,
        profile=check_name("profile.name", config["profile"]["name"]),
        best_among=best_among,
        results=Path(config["results"]),
        device=config["device"],
        workers=config["workers"],
        save_every_steps=config["schedule"]["save_every_steps"],
    )


def read_stage_settings(config: Config) -> StageSettings:
    """The settings of a stage's config; keys that older stages lack have their default."""
    return StageSettings(
        seed=config["seed"],
        precision=config.get("precision", "float32"),
        compile=config.get("compile", False),
        batch_size=config["schedule"]["batch_size"],
        checkpoint_every=config["schedule"]["checkpoint_every"],
        crop=config["data"]["crop"],
        calibration=config["data"]["calibration"],
        cloud=CloudFormat(**config["data"].get("cloud", {})),
        image_size=checked_size(config["data"].get("image_size")),
        classes=tuple(config.get("classes", CARS)),
        max_boxes=config["detections"]["max_boxes"],
        min_score=config["detections"]["min_score"],
    )


def stage_folder(config: Config, root: Path) -> KittiFolder:
    """A KITTI folder, read as a stage's config says, whatever trains it."""
    data = config["data"]
    cloud = CloudFormat(**data.get("cloud", {}))
    size = checked_size(data.get("image_size"))
    classes = tuple(config.get("classes", CARS))
    return KittiFolder(root, data["crop"], data["calibration"], cloud, size, classes)


def _data(section: Mapping[str, Any], classes: tuple[str, ...]) -> DataSettings:
    paths = {key: section[key] for key in ("root", "mapping")}
    read: dict[str, Any] = {
        key: None if path is None else Path(path) for key, path in paths.items()
    }
    read["cloud"] = CloudFormat(**section.get("cloud", {}))
    read["image_size"] = checked_size(section.get("image_size"))
    read["name"] = check_name("data.name", section["name"])
    read["classes"] = classes
    return DataSettings(**{**section, **read})


def _store(section: Mapping[str, Any]) -> StoreSettings:
    return StoreSettings(**{**section, "root": Path(section["root"])})


def _sweep(section: Mapping[str, Any], protocol: Protocol) -> SweepSettings:
    primary = section["primary"]
    if f"ap_{primary}" not in protocol.metric_names:
        possible = [name.removeprefix("ap_") for name in protocol.metric_names]
        raise ConfigError(
            f"sweep.primary: no metric '{primary}'. {options(str(primary), possible)}"
        )
    margin = section["margin"]
    if not isinstance(margin, int | float) or isinstance(margin, bool) or not margin > 0:
        raise ConfigError(f"sweep.margin: {margin}, but it is a gain in AP above 0, such as 1")
    groups = section["groups"]
    return SweepSettings(
        **{
            **section,
            "name": check_name("sweep.name", section["name"]),
            "factor": _keys(section["factor"]),
            "groups": None if groups is None else _keys(groups),
            # Those of papers are of cars, as the papers'.
            "tables": tuple(section["tables"]) if protocol.classes == CARS else (),
        }
    )


def _keys(value: Any) -> tuple[str, ...]:
    """One key, several, or none."""
    if value is None:
        return ()
    return (value,) if isinstance(value, str) else tuple(value)
