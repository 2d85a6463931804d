"""From the points that a sweeper proposes to a plan: refuses now what would fail after hours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from fl3d.config import locate
from fl3d.digests import digest
from fl3d.errors import ConfigError, options
from fl3d.records import Config, Stage
from fl3d.reports.published import REPORT_TABLES
from fl3d.reports.selection import STAGES
from fl3d.results import names
from fl3d.sweep.identity import result_config
from fl3d.sweep.plan import DataInfo, Plan, make_plan
from fl3d.sweep.sweepers.base import Point
from fl3d.training.build import build_augmentation, build_detector, build_optimizer
from fl3d.training.precision import check_precision
from fl3d.training.trainer import VERSION as TRAINER_VERSION

# Config sections that all trials of a sweep share: one dataset, one protocol, one store.
SHARED = ("data", "protocol", "store", "results", "device", "workers", "profile", "sweep", "selection")


class Planner:
    """Plans the trials of one sweep.

    Args:
        base: what all its trials share.
        data: identity and size of the data.

    Raises:
        ConfigError: a selection that does not exist.
    """

    def __init__(self, base: Config, data: DataInfo) -> None:
        self.base, self.data = base, data
        self.name = names(base).experiment
        self.detectors: dict[str, Any] = {}
        if base["selection"]["stages"] not in STAGES:
            raise ConfigError(f"selection.stages: {options(base['selection']['stages'], STAGES)}")

    def empty(self) -> Plan:
        """A plan without trials."""
        return Plan(self.name, (), {})

    def plan(self, points: Sequence[Point]) -> Plan:
        """Lay out points.

        Raises:
            ConfigError: values that no object takes, tables that cannot be made of these trials, or trials that
                differ in what all must share.
        """
        for point in points:
            self._check(point)
        self._check_tables(points)
        versions = {"trainer": TRAINER_VERSION} | {t: self._version(d) for t, d in self.detectors.items()}
        offered = {t: d.STAGES for t, d in self.detectors.items()}
        plan = make_plan(self.name, [(p.overrides, p.config) for p in points], self.data, versions, offered)
        for stage in plan.stages.values():  # each may set its own
            check_precision(stage.config["precision"], self.base["device"])
            if stage.config["compile"]:
                with torch.device("meta"):
                    build_detector(stage.config).compile_dense()
            self._check_start(stage)
        return plan

    def _version(self, detector: Any) -> object:
        """Of a detector; what a 2D detector found belongs to it where it reads that.

        Raises:
            ConfigError: it reads that, and there is none.
        """
        if not detector.IMAGE_BOXES:
            return detector.VERSION
        if self.data.image_digest is None:
            raise ConfigError(
                f"detector: {detector.NAME} needs 2D boxes, rgb_detections/rgb_detection_{{train,val}}.txt in data.root"
            )
        return [detector.VERSION, self.data.image_digest]

    def _check_start(self, stage: Stage) -> None:
        """Refuse a first stage with frozen parts: nothing would ever have trained them."""
        if stage.parent is None:
            with torch.device("meta"):
                frozen = [name for name, p in build_detector(stage.config).named_parameters() if not p.requires_grad]
            if frozen:
                part = frozen[0].partition(".")[0]
                raise ConfigError(
                    f"schedule.stages: '{stage.name}' comes first, but nothing would have trained its {part}"
                )

    def key(self, point: Point) -> str:
        """The key of a point's trial."""
        return self.plan([point]).trials[0].key

    def detector_names(self) -> dict[str, str]:
        """What the papers call the detectors, by ``_target_``."""
        return {target: detector.NAME for target, detector in self.detectors.items()}

    def _check(self, point: Point) -> None:
        for key in SHARED:
            if point.config[key] != self.base[key]:
                raise ConfigError(f"{key}: all trials of a sweep must share it; run one sweep for each value")
        target = point.config["detector"]["_target_"]
        self.detectors.setdefault(target, locate(target, "detector._target_"))
        with torch.device("meta"):
            build_optimizer(point.config, build_detector(point.config))
        if build_augmentation(point.config) is not None and not self.detectors[target].AUGMENTED:
            raise ConfigError(f"augment: {self.detectors[target].NAME} has its own in its YAML; augment must be null")

    def _check_tables(self, points: Sequence[Point]) -> None:
        tables = self.base["sweep"]["tables"]
        keys = {digest(result_config(point.config)) for point in points}
        for number in set(tables) - set(REPORT_TABLES):  # whose rows are what is swept
            key = "normalize" if number == "V" else "gamma"
            rows = {(p.config["detector"]["_target_"], p.config["loss"].get(key, 0), p.config["seed"]) for p in points}
            if len(rows) < len(keys):
                raise ConfigError(
                    f"sweep.tables: Table {number} has one row for each detector and loss.{key} (seeds are averaged); "
                    "these trials differ in something else. Sweep it without +sweep."
                )
