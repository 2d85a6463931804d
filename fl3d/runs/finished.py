"""A finished sweep: the one reader of what a store folder, or a results folder, holds of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from fl3d.config.settings import Settings
from fl3d.core.digests import digest
from fl3d.core.errors import StoreError, options
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.detections import (
    Validation,
    compare_stored,
    read_detections,
    read_validation,
)
from fl3d.evaluation.protocol import Protocol, split_metric
from fl3d.evaluation.selection import select
from fl3d.evaluation.stored import StoredDetections
from fl3d.reports.levels import Levels
from fl3d.runs.design import SEED, baseline_level, detector_levels, factor_name, in_order, label_of
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.plans import FrozenPlan, FrozenTrial, read_plan
from fl3d.runs.scores import read_score_file, score_file, tidy
from fl3d.runs.spec import read_spec
from fl3d.store.base import Store
from fl3d.store.opening import open_store

Asked = Mapping[str, Sequence[Any]]


@dataclass(frozen=True)
class FinishedTrial:
    """A trial that is trained to its end.

    Args:
        plan: what it is.
        folders: of its stages, first to last; none where its scores come from a results folder.
    """

    plan: FrozenTrial
    folders: tuple[RunFolder, ...]

    @property
    def key(self) -> str:
        """Its identity: the key of its last stage."""
        return self.plan.key

    @property
    def group(self) -> str:
        """Label of what it shares with the trials that it is compared with."""
        return self.plan.group

    @property
    def level(self) -> str:
        """Label of its value of the factor."""
        return self.plan.level

    @property
    def seed(self) -> int:
        """Of its training."""
        return self.plan.seed

    @property
    def detector(self) -> str:
        """As the papers write it."""
        return self.plan.detector

    @property
    def folder(self) -> RunFolder:
        """Run folder of its last stage.

        Raises:
            StoreError: its scores come from a results folder, which has no run folders.
        """
        if not self.folders:
            raise StoreError(
                f"{self.key}: only its scores are here; run the sweep to have its checkpoints"
            )
        return self.folders[-1]

    @property
    def last_step(self) -> int:
        """Step of its last checkpoint."""
        return self.folder.steps()[-1]

    def holder(self, step: int) -> RunFolder:
        """Run folder of the stage that holds a checkpoint.

        Raises:
            StoreError: none does.
        """
        for folder in reversed(self.folders or (self.folder,)):
            if step in folder.steps():
                return folder
        raise StoreError(
            f"{self.key}: neither it nor a stage it resumes from has a checkpoint at step {step}"
        )


@dataclass(frozen=True, kw_only=True)
class FinishedSweep:
    """A sweep of which at least one trial is done.

    Args:
        settings: of the sweep.
        plan: all trials that were planned.
        trials: those that are done, in the sweep's order.
        scores: a row for each trial and step, see ``runs.scores``.
        source: where the scores come from: a store folder, or a file of scores.
        asked: labels of values by key, where only trials with these were asked for.
        class_name: of its several classes the one that is looked at, see ``of_class``; None: the one class, or the
            mean over all.
    """

    settings: Settings
    plan: FrozenPlan
    trials: tuple[FinishedTrial, ...]
    scores: pd.DataFrame
    source: Path
    asked: Mapping[str, frozenset[str]] = field(default_factory=dict)
    class_name: str | None = None

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
            label_of(_value(trial, key)) in labels
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
        kitti, ids = self.kitti(), self.validation.ids
        return digest([kitti.digest(ids), kitti.image_digest(ids)])

    def drawn_as(self, name: str) -> Path | None:
        """Where a figure of it is kept as it was drawn, see ``runs.drawn``; None where only its scores are here."""
        if not self.is_from_store:
            return None
        return StoreFolder(self.settings.store.root).drawn(self.settings.experiment, name)

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


def scores_of_class(scores: pd.DataFrame, name: str) -> pd.DataFrame:
    """Scores of one of several classes, named as if it were the only one."""
    metrics = [str(c) for c in scores if str(c).startswith(("ap_", "recall_"))]
    own = {c: split_metric(c)[0] for c in metrics if split_metric(c)[1] == name}
    return scores.drop(columns=[c for c in metrics if c not in own]).rename(columns=own)


def levels_of(sweep: FinishedSweep) -> Levels:
    """The levels of a sweep, as tables and figures tell them."""
    return Levels(factor_name(sweep.factor), sweep.levels, sweep.baseline)


def open_sweep(
    settings: Settings, asked: Asked | None = None, published: Path | None = None
) -> FinishedSweep:
    """Open a sweep that was run before: from the store, or else from a file of its scores.

    Args:
        settings: of the sweep.
        asked: values by key: of the sweep's trials those that have one of them.
        published: folder of results that were published, tried after ``settings.results``; None: none.

    Raises:
        StoreError: no trial of it is done, or none is asked for.
    """
    found = _from_store(settings)
    if found is None:
        found = _from_files(settings, published)
    return asked_for(found, asked or {})


def is_stored(settings: Settings, published: Path | None = None) -> bool:
    """Whether a sweep was planned in the store, or a results folder holds its scores."""
    places = [settings.results, *([published] if published else [])]
    files = [score_file(place / settings.folder_name, settings.sweep.name) for place in places]
    plan = StoreFolder(settings.store.root).plan(settings.experiment)
    return plan.exists() or any(file.exists() for file in files)


def _from_store(settings: Settings) -> FinishedSweep | None:
    layout = StoreFolder(settings.store.root)
    path = layout.plan(settings.experiment)
    if not path.exists():
        return None
    plan = read_plan(path)
    trials = [
        FinishedTrial(trial, tuple(layout.run(key) for key in trial.stages))
        for trial in plan.trials
        if layout.run(trial.key).is_done
    ]
    raw = open_store(settings.store.root, settings.store.uri).read(settings.stored_as)
    scores = tidy(raw, [trial.plan for trial in trials], settings.protocol)
    if scores.empty:
        return None
    logged = set(scores["trial"])
    kept = tuple(trial for trial in trials if trial.key in logged)
    return FinishedSweep(
        settings=settings, plan=plan, trials=kept, scores=scores, source=settings.store.root
    )


def _from_files(settings: Settings, published: Path | None) -> FinishedSweep:
    places = [settings.results, *([published] if published else [])]
    files = [score_file(place / settings.folder_name, settings.sweep.name) for place in places]
    file = next((file for file in files if file.exists()), None)
    if file is None:
        tried = " or ".join(str(file) for file in files)
        layout = StoreFolder(settings.store.root)
        planned = layout.plan(settings.experiment)
        asked = read_plan(planned).trials if planned.exists() else ()
        if asked and not any(layout.run(trial.key).is_done for trial in asked):
            raise StoreError(
                f"{settings.experiment}: none of its {len(asked)} trials is done yet; the command that started it "
                "resumes it"
            )
        raise StoreError(
            f"{settings.store.root}: no scores of {settings.experiment}, and none in {tried}; run the sweep first"
        )
    plan, scores = read_score_file(file, settings.protocol)
    done = set(scores["trial"])
    trials = tuple(FinishedTrial(trial, ()) for trial in plan.trials if trial.key in done)
    return FinishedSweep(settings=settings, plan=plan, trials=trials, scores=scores, source=file)


def asked_for(sweep: FinishedSweep, asked: Asked) -> FinishedSweep:
    """The sweep's trials with the values that were asked for, and the baseline beside other levels.

    Raises:
        StoreError: none of its trials has one of the values.
    """
    told = [
        key
        for key in asked
        if key == SEED or any(key in trial.plan.values for trial in sweep.trials)
    ]  # the others are not what the sweep's trials differ in
    chosen = sweep.trials
    for key in told:
        chosen = _with_values(sweep, chosen, key, asked[key])
    outside = [key for key in told if key not in sweep.factor]
    baseline = [trial for trial in sweep.trials if trial.level == sweep.baseline]
    for key in outside:
        wanted = {label_of(value) for value in asked[key]}
        baseline = [trial for trial in baseline if label_of(_value(trial.plan, key)) in wanted]
    keys = {trial.key for trial in (*chosen, *baseline)}
    scores = sweep.scores[sweep.scores["trial"].isin(keys)].reset_index(drop=True)
    trials = tuple(trial for trial in sweep.trials if trial.key in keys)
    labels = {key: frozenset(label_of(value) for value in asked[key]) for key in told}
    return replace(sweep, trials=trials, scores=scores, asked=labels)


def _with_values(
    sweep: FinishedSweep, trials: Sequence[FinishedTrial], key: str, values: Sequence[Any]
) -> tuple[FinishedTrial, ...]:
    """Those of some trials that have one of some values.

    Raises:
        StoreError: none of them has one of the values.
    """
    wanted = {label_of(value) for value in values}
    stored = {label_of(_value(trial.plan, key)) for trial in trials}
    for label in sorted(wanted - stored):
        raise StoreError(
            f"{key}={label}: {sweep.settings.experiment} has no finished trial with it. "
            f"{options(label, stored)}"
        )
    return tuple(trial for trial in trials if label_of(_value(trial.plan, key)) in wanted)


def _value(trial: FrozenTrial, key: str) -> Any:
    return trial.seed if key == SEED else trial.values.get(key)
