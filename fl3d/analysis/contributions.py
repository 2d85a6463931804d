"""What a trial contributes to what is said of its sweep: resampled APs, curves, halves; made once, and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fl3d.analysis.samples import Float, Resampled, Samples, counted, resample
from fl3d.analysis.split_halves import halved
from fl3d.core.digests import file_digest
from fl3d.core.errors import DataError
from fl3d.data.label_table import LabelTable
from fl3d.evaluation.average_precision import Comparison, Curve
from fl3d.evaluation.bootstrap import N_RESAMPLES
from fl3d.evaluation.scoring import compare_stored
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.kept import Arrays, code_digest, is_kept, kept
from fl3d.runs.trials import FinishedTrial
from fl3d.runs.units import Units, units_of

# What their values come from, besides detections and labels.
CODE = (
    *("geometry", "data", "evaluation"),
    *("analysis/contributions.py", "analysis/samples.py", "analysis/split_halves.py"),
)
CUTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
CELL = ("3d", "moderate")  # of curves
COUNTED = ("3d", "hard")  # of boxes that are hits: every ground truth that counts at all


@dataclass(frozen=True)
class Posteriors:
    """Scores of the boxes that an evaluation gets of a checkpoint: after cut and suppression.

    Args:
        boxes: (N,) of all.
        hits: (H,) of those that its matching gives to a ground truth (3D, hard: all that count).
    """

    boxes: Float
    hits: Float


class Contributions:
    """What the trials of a sweep contribute: read where it is kept, else made and kept.

    Args:
        sweep: its run folders must be at hand.
        n_resamples: of the frames.
    """

    def __init__(self, sweep: FinishedSweep, n_resamples: int = N_RESAMPLES) -> None:
        self.sweep = sweep
        self.n_resamples = n_resamples
        self._samples: dict[str, Samples] = {}
        self._digests: dict[Path, str] = {}
        self._steps: dict[str, dict[str, int]] = {}
        self._held: tuple[str, dict[int, Comparison]] = ("", {})  # of the trial looked at last

    @cached_property
    def units(self) -> Units:
        """What is resampled."""
        return units_of(self.sweep)

    def samples(self, rule: str = "last") -> Samples:
        """APs of all trials in the same resamples, by group, level and seed.

        Args:
            rule: which checkpoint stands for a trial, see ``evaluation.selection.select``.

        Raises:
            StoreError: only its scores are here.
            DataError: detections or labels cannot be read.
        """
        if rule not in self._samples:
            self._samples[rule] = self._sampled(rule)
        return self._samples[rule]

    def _sampled(self, rule: str) -> Samples:
        found: dict[str, dict[str, dict[int, Resampled]]] = {
            group: {level: {} for level in self.sweep.levels} for group in self.sweep.groups
        }
        for trial in self.sweep.trials:
            own = self.resampled(trial, self._step(trial, rule))
            found[trial.group][trial.level][trial.seed] = own
        return {
            group: {level: by_seed for level, by_seed in levels.items() if by_seed}
            for group, levels in found.items()
        }

    def resampled(self, trial: FinishedTrial, step: int) -> Resampled:
        """APs of a checkpoint in resamples of the frames."""

        def make() -> Arrays:
            compared = self._compared(trial, step)
            own = resample(compared, self.units.of_frames, self.n_resamples, self.sweep.classes)
            detections = np.frombuffer(own.detections.encode(), dtype=np.uint8)
            return {"values": own.values, "draws": own.draws, "detections": detections}

        found = self._kept(trial, step, "resampled", make)
        return Resampled(found["values"], found["draws"], found["detections"].tobytes().decode())

    def precision(self, trial: FinishedTrial) -> Float:
        """Precision of a trial's last checkpoint over recall, 3D moderate: (41,)."""

        def make() -> Arrays:
            curves = self._curves(self._compared(trial, trial.last_step))
            return {"precision": np.mean([one.precision for one in curves], axis=0)}

        return self._kept(trial, trial.last_step, "precision", make)["precision"]

    def at_cuts(self, trial: FinishedTrial) -> Float:
        """3D AP moderate (R11) of a trial's last checkpoint where lower scores are dropped: one of each of ``CUTS``."""
        return self._kept(trial, trial.last_step, "cuts", lambda: {"aps": self._cut(trial)})["aps"]

    def posteriors(self, trial: FinishedTrial) -> Posteriors:
        """Scores of the boxes of a trial's last checkpoint, of all classes that are looked at."""

        def make() -> Arrays:
            compared = self._compared(trial, trial.last_step)
            own = [compared.det.scores[compared.det.of(name)] for name in self.sweep.classes]
            matched = [compared.matches(name, *COUNTED) for name in self.sweep.classes]
            hits = [found.hit_scores for found in matched]
            return {"boxes": np.concatenate(own), "hits": np.concatenate(hits)}

        found = self._kept(trial, trial.last_step, "posteriors", make)
        return Posteriors(found["boxes"], found["hits"])

    def _cut(self, trial: FinishedTrial) -> Float:
        uncut = replace(self.sweep.protocol, score_threshold=min(CUTS))
        if uncut == self.sweep.protocol:
            compared = self._compared(trial, trial.last_step)
        else:
            compared = compare_stored(self.sweep.detections(trial), self.sweep.validation, uncut)
        left = [self._curves(above_cut(compared, cut)) for cut in CUTS]
        return np.array([np.mean([one.ap_r11 for one in curves]) for curves in left])

    def _curves(self, compared: Comparison) -> list[Curve]:
        """3D moderate, of each class that a mean is over."""
        return [compared.curve(name, *CELL) for name in counted(compared, CELL, self.sweep.classes)]

    def halves(self) -> pd.DataFrame:
        """What choosing by a half of the frames is worth: a row a trial, see ``split_halves.halved``.

        Returns:
            ``trial``, ``chosen`` and ``other``: AP of the chosen checkpoint on the half that chose it, and on the
            other.
        """
        rows = []
        for trial in self.sweep.trials:
            chosen, other = self.halved(trial)
            rows.append({"trial": trial.key, "chosen": chosen, "other": other})
        return pd.DataFrame(rows)

    def halved(self, trial: FinishedTrial) -> tuple[float, float]:
        """See ``split_halves.halved``."""

        def make() -> Arrays:
            compared = (self._compared(trial, step) for step in trial.folder.steps())
            return {"aps": np.array(halved(compared, self.sweep.classes))}

        chosen, other = self._kept(trial, trial.last_step, "halves", make)["aps"]
        return float(chosen), float(other)

    def missing(self, trial: FinishedTrial, rules: Sequence[str], curves: bool) -> bool:
        """Whether any part of what a trial contributes is not kept; arguments as ``make``."""
        return any(not is_kept(*self._place(*part)) for part in self._parts(trial, rules, curves))

    def make(self, trial: FinishedTrial, rules: Sequence[str], curves: bool) -> None:
        """Make and keep what a trial contributes.

        Args:
            trial: the trial.
            rules: by which its checkpoints are chosen that are resampled.
            curves: whether its curves and halves are wanted too.
        """
        for rule in rules:
            self.resampled(trial, self._step(trial, rule))
        self.posteriors(trial)  # hardly any work beside what they are held against
        if curves:
            self.precision(trial)
            self.at_cuts(trial)
            self.halved(trial)

    def _parts(
        self, trial: FinishedTrial, rules: Sequence[str], curves: bool
    ) -> Iterator[tuple[FinishedTrial, int, str]]:
        for rule in rules:
            yield trial, self._step(trial, rule), "resampled"
        for name in ("posteriors", *(("precision", "cuts", "halves") if curves else ())):
            yield trial, trial.last_step, name

    def _step(self, trial: FinishedTrial, rule: str) -> int:
        if rule not in self._steps:
            self._steps[rule] = self.sweep.steps(rule)
        return self._steps[rule][trial.key]

    def _kept(
        self, trial: FinishedTrial, step: int, name: str, make: Callable[[], Arrays]
    ) -> Arrays:
        return kept(*self._place(trial, step, name), make)

    def _place(self, trial: FinishedTrial, step: int, name: str) -> tuple[Path, Mapping[str, Any]]:
        """Where a part is kept, and what it is made of."""
        read = trial.folder.steps() if name == "halves" else [step]
        made_of: dict[str, Any] = {
            "detections": [self._digest(trial, one) for one in read],
            **self._common,
        }
        if name == "resampled":
            made_of |= {"units": self.units.of_frames.tolist(), "resamples": self.n_resamples}
        if name == "cuts":
            made_of |= {"cuts": list(CUTS)}
        parts = [name, self.sweep.protocol.id, self.sweep.class_name]
        kept_as = "-".join(part for part in parts if part is not None)
        return trial.holder(step).kept(step, kept_as), made_of

    @cached_property
    def _common(self) -> Mapping[str, Any]:
        """What all of it is made of."""
        protocol, validation = self.sweep.protocol, self.sweep.validation
        points = validation.points if protocol.difficulty == "points" else None
        return {
            "protocol": asdict(protocol),
            "classes": list(self.sweep.classes),
            "labels": validation.digest,
            "points": None if points is None else points.tolist(),
            "code": code_digest(*CODE),
        }

    def _digest(self, trial: FinishedTrial, step: int) -> str:
        """Of a checkpoint's detections.

        Raises:
            DataError: they are not there.
        """
        path = trial.holder(step).detections(step)
        if path not in self._digests:
            try:
                self._digests[path] = file_digest(path)
            except OSError as error:
                raise DataError(f"is not a file of detections ({error})", path) from None
        return self._digests[path]

    def _compared(self, trial: FinishedTrial, step: int) -> Comparison:
        """A checkpoint's detections held against the labels; those of one trial are held at a time."""
        key, held = self._held
        if key != trial.key:
            self._held = (trial.key, held := {})
        if step not in held:
            held[step] = self.sweep.comparison(trial, step)
        return held[step]


def above_cut(compared: Comparison, cut: float) -> Comparison:
    """What is left of a comparison where lower scores are dropped: as if the protocol had cut there.

    A box goes for a better one alone, so suppression leaves of the boxes from a score on what it leaves of all. A cut
    of 0 drops nothing.
    """
    det = compared.det
    above = det.scores >= (cut if cut > 0 else -np.inf)
    before = np.concatenate([[0], np.cumsum(above)]).astype(np.int64)  # boxes left before each
    return replace(
        compared,
        det=LabelTable(before[det.offsets], det.types[above], det.values[above], det.others),
        protocol=replace(compared.protocol, score_threshold=cut),
        overlaps=compared.overlaps.of(above),
    )
