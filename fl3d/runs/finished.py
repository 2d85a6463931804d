"""A finished sweep: what is known of its trials, frames and scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import pandas as pd

from fl3d.config.settings import Settings
from fl3d.data.frame_digests import input_digest
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.protocol import Protocol, split_metric
from fl3d.evaluation.scoring import compare_stored
from fl3d.evaluation.selection import select
from fl3d.evaluation.stored import StoredDetections
from fl3d.evaluation.validation import Validation, read_validation
from fl3d.reports.levels import Levels
from fl3d.runs.design import baseline_level, detector_levels, factor_name, in_order, label_of
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import FrozenPlan, FrozenTrial
from fl3d.runs.scores import scores_of_class
from fl3d.runs.spec import read_spec
from fl3d.runs.trials import FinishedTrial
from fl3d.store.base import Store
from fl3d.store.opening import open_store


@dataclass(frozen=True, kw_only=True)
class FinishedSweep:
    """A sweep of which at least one trial is done.

    Args:
        settings: of the sweep.
        plan: all trials that were planned.
        trials: those that are done and of which the store holds all scores, in the sweep's order.
        scores: a row for each trial and step, see ``runs.scores``.
        source: where the scores come from: a store folder, or a file of scores.
        asked: labels of values by key, where only trials with these were asked for.
        class_name: of its several classes the one that is looked at, see ``of_class``; None: the one class, or the
            mean over all.
        family: the same with all levels, where only some were asked for: what is said of these holds for all at once;
            None: all were.
        unshown: why trials that are done are not among these, by their keys: ``scores lack ap_3d/easy``.
    """

    settings: Settings
    plan: FrozenPlan
    trials: tuple[FinishedTrial, ...]
    scores: pd.DataFrame
    source: Path
    asked: Mapping[str, frozenset[str]] = field(default_factory=dict)
    class_name: str | None = None
    family: FinishedSweep | None = None
    unshown: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the sweep, and of the class where one of several is looked at."""
        own = self.settings.sweep.name
        return own if self.class_name is None else f"{own}-{self.class_name}"

    @property
    def classes(self) -> tuple[str, ...]:
        """Whose AP is looked at: the mean over them where they are several."""
        return self.protocol.classes if self.class_name is None else (self.class_name,)

    @property
    def primary_classes(self) -> tuple[str, ...]:
        """Classes that its primary metric is of."""
        named = self.settings.sweep.class_name
        return self.classes if named is None else (named,)

    def each_class(self) -> tuple[FinishedSweep, ...]:
        """The sweep as each of its classes sees it; none where it has but one."""
        return tuple(self.of_class(name) for name in self.classes) if len(self.classes) > 1 else ()

    def of_class(self, name: str) -> FinishedSweep:
        """The same sweep as one of its several classes sees it: scores, and the primary metric, are that class's."""
        asked = self.settings.sweep
        plain, _ = split_metric(asked.primary)
        return replace(
            self,
            settings=replace(self.settings, sweep=replace(asked, primary=plain)),
            scores=scores_of_class(self.scores, name),
            class_name=name,
            family=None if self.family is None else self.family.of_class(name),
        )

    @property
    def protocol(self) -> Protocol:
        """Of the scores."""
        return self.settings.protocol

    @property
    def factor(self) -> tuple[str, ...]:
        """Keys that are compared."""
        return self.plan.factor

    @cached_property
    def baseline(self) -> str:
        """Level that the others are held against: the one asked for now, or else when the sweep was run.

        Raises:
            ConfigError: ``sweep.baseline`` is no level of the sweep.
        """
        asked = self.settings.sweep.baseline
        if asked is None:
            return self.plan.baseline
        levels = list(dict.fromkeys(trial.level for trial in self.plan.trials))
        named = detector_levels(
            self.factor, [(trial.values, trial.level) for trial in self.plan.trials]
        )
        return baseline_level(levels, self.factor, asked, named)

    def against(self, level: str) -> FinishedSweep:
        """The same sweep, of which the other levels are held against this one."""
        if level == self.baseline:
            return self
        asked = replace(self.settings.sweep, baseline=level)
        return replace(self, settings=replace(self.settings, sweep=asked))

    @cached_property
    def levels(self) -> list[str]:
        """Labels of the levels of its trials: by number where they are numbers, else as the sweep names them."""
        done = {trial.level for trial in self.trials}
        return [
            level for level in in_order(trial.level for trial in self.plan.trials) if level in done
        ]

    @cached_property
    def groups(self) -> list[str]:
        """Labels of the groups of its trials, in alphabetical order."""
        return sorted({trial.group for trial in self.trials})

    @property
    def is_from_store(self) -> bool:
        """Whether its run folders are at hand."""
        return bool(self.trials[0].folders)

    def trial(self, key: str) -> FinishedTrial:
        """A trial by its key."""
        return next(trial for trial in self.trials if trial.key == key)

    def is_asked(self, trial: FrozenTrial) -> bool:
        """Whether a planned trial was asked for, done or not; the baseline is, beside any other level."""
        return all(
            label_of(trial.swept(key)) in labels
            for key, labels in self.asked.items()
            if trial.level != self.baseline or key not in self.factor
        )

    def select(self, rule: str) -> pd.DataFrame:
        """The checkpoint that stands for each trial, see ``evaluation.selection.select``."""
        return select(self.scores, rule, self.settings.best_among)

    def steps(self, rule: str) -> dict[str, int]:
        """Step of the checkpoint that stands for each trial, by the trial's key."""
        chosen = self.select(rule)
        return {
            str(key): int(step) for key, step in zip(chosen["trial"], chosen["step"], strict=True)
        }

    def runs(self, store: Store | None = None) -> dict[str, str]:
        """Ids of its trials' runs in a store, by the trials' keys; none where its scores come from a file.

        Args:
            store: None: the one that its settings name.
        """
        if not self.is_from_store:
            return {}
        store = store or open_store(self.settings.store.root, self.settings.store.uri)
        raw = store.read(self.settings.stored_as)
        own = raw[
            (raw["protocol"] == self.protocol.id)
            & raw["trial"].isin({trial.key for trial in self.trials})
        ]
        return dict(zip(own["trial"], own["run"], strict=True))

    def kitti(self) -> KittiFolder:
        """Its frames, where its settings say that they lie, or where they lay.

        Raises:
            DataError: they are not there, or others are.
        """
        return self._kitti

    @cached_property
    def _kitti(self) -> KittiFolder:
        spec = read_spec(self.trials[0].folder)
        given = self.settings.data.root
        if given is not None and self.settings.data.generate:
            given = given / spec.machine.data_root.name  # below it lie several simulated ones
        is_there = given is not None and (given / "training").is_dir()
        return spec.kitti(given if is_there else None)

    @cached_property
    def validation(self) -> Validation:
        """Labels and calibrations of its validation frames."""
        return read_validation(self.kitti(), read_spec(self.trials[0].folder).machine.val_ids)

    @cached_property
    def frames_digest(self) -> str:
        """Identity of all that a network reads of its validation frames.

        Raises:
            DataError: they are not there.
        """
        return input_digest(self.kitti(), self.validation.ids)

    def drawn_as(self, name: str) -> Path | None:
        """Where a figure of it is kept as it was drawn, see ``runs.drawn``; None of a part, or of scores alone."""
        if not self.is_from_store or self.settings.part:
            return None
        return StoreFolder(self.settings.store.root).drawn(self.settings.experiment, name)

    def is_undrawn(self, name: str) -> bool:
        """Whether a figure of it was never drawn, where drawn ones are kept; one that was may show what has changed."""
        kept_as = self.drawn_as(name)
        return kept_as is not None and not kept_as.exists()

    def kept_as(self, name: str) -> Path | None:
        """Where something is kept that is made of no trial alone, see ``kept``; None where only its scores are here."""
        return StoreFolder(self.settings.store.root).kept(name) if self.is_from_store else None

    def detections(self, trial: FinishedTrial, step: int | None = None) -> StoredDetections:
        """What a checkpoint of a trial predicted on the validation frames; None: its last one."""
        at = trial.last_step if step is None else step
        return read_detections(trial.holder(at).detections(at))

    def comparison(self, trial: FinishedTrial, step: int | None = None) -> Comparison:
        """A checkpoint's detections held against the labels, under the sweep's protocol."""
        return compare_stored(self.detections(trial, step), self.validation, self.protocol)


def levels_of(sweep: FinishedSweep) -> Levels:
    """The levels of a sweep, as tables and figures tell them."""
    return Levels(factor_name(sweep.factor), sweep.levels, sweep.baseline)
