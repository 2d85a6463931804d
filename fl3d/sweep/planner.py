"""From the points that a sweeper proposes to a plan: refuses now what would fail after hours."""

from __future__ import annotations

import sys
from collections import ChainMap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fl3d.config.settings import Settings
from fl3d.core.counting import counted
from fl3d.core.errors import ConfigError
from fl3d.core.nested import leaves
from fl3d.core.records import Config, Stage, Trial
from fl3d.runs.design import (
    Design,
    asked_label,
    baseline_level,
    detector_levels,
    make_design,
    refuse_lone_level,
    refuse_twins,
)
from fl3d.runs.plans import FrozenPlan, FrozenTrial, freeze
from fl3d.sweep.detectors import planned
from fl3d.sweep.identity import result_config
from fl3d.sweep.plan import DataInfo, Plan, check_names, trial_stages
from fl3d.sweep.sweepers.base import Point

# Keys and sections that all trials of a sweep share: one list of classes, one dataset, one protocol, one store.
SHARED = (
    "classes",
    "data",
    "protocol",
    "store",
    "results",
    "device",
    "workers",
    "profile",
    "sweep",
    "selection",
)


class Planner:
    """Plans the trials of one sweep.

    Args:
        base: config that all its trials share.
        settings: the same, typed.
        swept: keys in which its trials differ.
        data: identity and size of the data.
        grows: whether trials are proposed while others run: then the baseline may come later.

    Attributes:
        looks: numbers of seeds after which verdicts are asked for, or were, see ``setup.paid_looks``.
    """

    def __init__(
        self,
        base: Config,
        settings: Settings,
        swept: Iterable[str],
        data: DataInfo,
        grows: bool = False,
    ) -> None:
        self.looks: tuple[int, ...] = ()
        self.grows = grows
        self.base = base
        self.settings = settings
        self.data = data
        # Of a single trial every word counts as swept; what all trials must share is not compared.
        compared = [key for key in swept if key.partition(".")[0] not in SHARED]
        self.design: Design = make_design(compared, settings.sweep)
        self._common = _shared_leaves(base)
        self._checked: set[str] = set()
        self._frozen: dict[str, FrozenTrial] = {}
        # Of each set of dotted keys the first config that has them.
        self._flat: dict[tuple[str, ...], dict[str, Any]] = {}
        self._sections: dict[tuple[str, str], Any] = {}  # of stages' configs, by name and content

    def empty(self) -> Plan:
        """A plan without trials."""
        return Plan(self.settings.experiment, (), {})

    def plan(self, points: Sequence[Point], grown: Plan | None = None) -> Plan:
        """Lay out points.

        Args:
            points: new ones.
            grown: a plan that they are added to; None: a new one.

        Raises:
            ConfigError: values that no object takes, trials that differ in what all must share, or two trials that the
                sweep's design does not tell apart.
        """
        check_names([point.config for point in points])
        before = grown or self.empty()
        trials = {trial.key: trial for trial in before.trials}
        stages = dict(before.stages)
        with counted("planning", len(points), "trial") as advance:
            for point in points:
                trial, chain = self._lay_out(point)
                _refuse_unused(trial, trials.setdefault(trial.key, trial))
                for stage in chain:
                    stages.setdefault(stage.key, stage)
                advance(1)
        refuse_twins(trials.values())
        return Plan(before.sweep, tuple(trials.values()), stages)

    def key(self, point: Point) -> str:
        """The key of a point's trial."""
        return self._lay_out(point)[0].key

    def frozen(self, plan: Plan, earlier: Iterable[str] = ()) -> FrozenPlan:
        """A plan as it is kept on disk.

        Args:
            plan: of this planner.
            earlier: stages of trials of earlier starts.

        Raises:
            ConfigError: ``sweep.baseline`` is no level of it.
        """
        return FrozenPlan(
            factor=self.design.factor,
            baseline=self.baseline(plan),
            trials=tuple(self._as_kept(trial) for trial in plan.trials),
            earlier=tuple(set(earlier) - set(plan.stages)),
            looks=self.looks,
        )

    def check(self, plan: Plan) -> str:
        """Refuse a first plan that does not compare what was asked for; the level that the others are held against.

        Raises:
            ConfigError: ``sweep.factor`` does not vary though other keys do, or ``sweep.baseline`` is no level of it.
        """
        if not self.grows:
            refuse_lone_level(self.settings.sweep.factor, plan.trials)
        return self.baseline(plan)

    def baseline(self, plan: Plan) -> str:
        """The level that the others are held against.

        Raises:
            ConfigError: ``sweep.baseline`` is no level of the plan.
        """
        factor, asked = self.design.factor, self.settings.sweep.baseline
        levels = list(dict.fromkeys(trial.level for trial in plan.trials))
        if self.grows and asked is not None:
            levels.append(asked_label(factor, asked))
        names = detector_levels(factor, ((one.values, one.level) for one in plan.trials))
        return baseline_level(levels, factor, asked, names)

    def _as_kept(self, trial: Trial) -> FrozenTrial:
        """A trial as the plan's file has it; of a plan that grows it is made once."""
        kept = self._frozen.get(trial.key)
        if kept is None:
            kept = freeze(trial, self._by_dotted_key(result_config(trial.config)))
            if self.grows:
                self._frozen[trial.key] = kept
        return kept

    def _by_dotted_key(self, config: Config) -> Mapping[str, Any]:
        """A config by dotted key; it keeps what it differs in from the first of the same keys."""
        flat = dict(leaves(config))
        first = self._flat.setdefault(tuple(flat), flat)
        own = {key: flat[key] for key in first if repr(flat[key]) != repr(first[key])}
        return ChainMap(own, first)

    def _lay_out(self, point: Point) -> tuple[Trial, list[Stage]]:
        """The trial of one point, and its stages."""
        _refuse_other(point, self._common)
        its = planned(point.config)
        its.check()
        config = its.config
        detector = its.info(self.data)
        stages = [
            replace(stage, config=self._shared(stage.config))
            for stage in trial_stages(config, self.data, its.trainer_version, detector)
        ]
        for stage in stages:
            if stage.key not in self._checked:
                its.check_stage(stage, self.settings.device)
                self._checked.add(stage.key)
        trial = Trial(
            key=stages[-1].key,
            overrides=point.overrides,
            values=point.values,
            config=config,
            stages=tuple(stage.key for stage in stages),
            first_own_step=stages[-1].start_step,
            detector=detector.name,
            group=self.design.group(point.values, config, detector.name),
            level=self.design.level(point.values, config, detector.name),
            seed=config["seed"],
        )
        return trial, stages

    def _shared(self, config: Config) -> Config:
        """An equal config that takes sections of other stages where they are equal: it keeps what it differs in."""
        return {
            sys.intern(key): self._sections.setdefault((key, repr(value)), value)
            if isinstance(value, dict)
            else value
            for key, value in config.items()
        }


def check_shared(points: Iterable[Point], base: Config) -> None:
    """Refuse trials that differ in what all must share; it needs no data.

    Raises:
        ConfigError: naming the key.
    """
    shared = _shared_leaves(base)
    for point in points:
        _refuse_other(point, shared)


def _refuse_other(point: Point, shared: Mapping[str, Any]) -> None:
    own = _shared_leaves(point.config)
    for key in {**own, **shared}:
        if key not in own or key not in shared or own[key] != shared[key]:
            raise ConfigError(
                f"{key}: all trials of a sweep must share it; run one sweep for each value"
            )


def _shared_leaves(config: Config) -> dict[str, Any]:
    return dict(leaves({section: config[section] for section in SHARED if section in config}))


def _refuse_unused(trial: Trial, other: Trial) -> None:
    """Refuse two points that would be trained as one: what they differ in changes nothing.

    Raises:
        ConfigError: naming the keys.
    """
    if trial.overrides == other.overrides:
        return
    differing = {
        key: value for key, value in trial.values.items() if other.values.get(key) != value
    }
    why = planned(trial.config).unused(differing) if differing else ""
    if why:
        raise ConfigError(why)
    if trial.values.keys() == other.values.keys() and not differing:
        reason = "their values are equal"  # as 2 and 2.0 are
    else:
        reason = "nothing that is trained reads it, or another word overrules it"
    own, others = (
        " ".join(word for word in one.overrides if word not in another.overrides)
        for one, another in ((other, trial), (trial, other))
    )
    raise ConfigError(
        f"'{own or 'nothing'}' and '{others or 'nothing'}' are one and the same training, so that they cannot be "
        f"compared: {reason}"
    )
