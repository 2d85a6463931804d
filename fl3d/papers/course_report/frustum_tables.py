"""Tables 6 and 7 of the course report: AP of Frustum ConvNet by setting, and of both detectors.

They are fed by several sweeps: a row's trial is found by the values in which it differs from the default.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from fl3d.evaluation.selection import select
from fl3d.papers.base import PaperTable
from fl3d.papers.course_report.published_cells import published_table
from fl3d.reports.seeds import PAIRED, UNPAIRED, seeds_note
from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.design import SEED
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

LEVELS = {"easy": "Easy", "medium": "Medium", "hard": "Hard"}
KITTI_LEVEL = {"easy": "easy", "medium": "moderate", "hard": "hard"}
METRICS = {"bbox": "image", "bev": "bev", "3d": "3d"}
FINAL_METRICS = [
    f"ap_{metric}/{KITTI_LEVEL[level]}" for level in LEVELS for metric in METRICS.values()
]
FCONVNET = "F-ConvNet"
POINTRCNN = "PointRCNN"
NAMES = {POINTRCNN: "PointRCNN", FCONVNET: "Frustum ConvNet"}
FIRST = "first"
SECOND = "refinement"
WIDE = [1.0, 2.0, 4.0, 8.0]
NARROW = [0.5, 1.0, 2.0, 4.0]
# What a row's trial is swept to, by stage and printed setting. A batch is of frames, with 8 frustums each.
SETTINGS: Mapping[tuple[str, str], Mapping[str, Any]] = {
    (FIRST, "Default Parameters"): {"loss.alpha": 0.25},
    (FIRST, "Batch Size = 64"): {"schedule.batch_size": 8},
    (FIRST, "Batch Size = 8"): {"schedule.batch_size": 1},
    (FIRST, "s and u_half = 1,2,4,8"): {"detector.slabs": {"stride": WIDE, "half": WIDE}},
    (FIRST, "s and u_half = 0.5,1,2,4"): {"detector.slabs": {"stride": NARROW, "half": NARROW}},
    (FIRST, "Alpha = 0.2"): {"loss.alpha": 0.2},
    (FIRST, "Alpha = 0.3"): {"loss.alpha": 0.3},
    (FIRST, "Head_REG Weight = 30"): {"detector.weights": {"yaw": 30.0}},
    (FIRST, "Heading_class loss multiplier = 1.5"): {"detector.weights": {"yaw_bin": 1.5}},
    (SECOND, "Default Parameters"): {"loss.alpha": 0.25},
    (SECOND, "Our Final Parameters"): {"loss.alpha": 0.3},
}
FINAL = SETTINGS[SECOND, "Our Final Parameters"]
RCNN_BIN = "detector.rcnn.bin"


def swept(trial: FrozenTrial) -> dict[str, Any]:
    """What a trial is swept to, its seed apart."""
    return {key: value for key, value in trial.values.items() if key != SEED}


class FrustumTable(PaperTable):
    """Table 6: 3D AP of Frustum ConvNet, settings that were not run left out; bold: better than its stage's default."""

    name = "course_report.frustum"
    number = "R6"
    title = "Table 6 of the report."
    is_joint = True

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """The printed settings that it stands for."""
        if trial.detector != FCONVNET:
            return None
        stage = SECOND if trial.first_own_step else FIRST
        return next(
            (key for key, values in SETTINGS.items() if key[0] == stage and values == swept(trial)),
            None,
        )

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """A row a printed setting."""
        ends = stage_ends(sweeps)
        rows: list[tuple[Cell, ...]] = []
        base: dict[str, list[dict[str, Any]]] = {}
        seeds: dict[str, list[int]] = {}
        for printed in published_table(self.number).to_dict("records"):
            stage = str(printed["stage"])
            setting = str(printed["setting"])
            own = [
                row
                for row in ends
                if row["stage"] == stage and row["values"] == SETTINGS[stage, setting]
            ]
            if not own:
                continue
            if setting == "Default Parameters":
                base.setdefault(stage, own)
            rows.append(_frustum_row(printed, own, base.get(stage, [])))
            seeds[f"{stage}: {setting}"] = [int(row["seed"]) for row in own]
        if not rows:
            return None
        columns = (
            Column("section", ""),
            Column("setting", "Setting"),
            *(Column(f"3d_{level}", head, "3D AP, ours", True) for level, head in LEVELS.items()),
            *(
                Column(f"3d_{level}_published", head, "3D AP, report", True)
                for level, head in LEVELS.items()
            ),
        )
        legend = "AP in percent; bold: better than the default of the same stage"
        caption = "Frustum ConvNet by setting: last models"
        notes = (*notes, seeds_note(seeds, PAIRED))
        return Table(self.number, caption, columns, tuple(rows), legend, notes, title=self.title)


def _texts(rows: Sequence[Mapping[str, Any]], seeds: Collection[int]) -> list[str]:
    """Printed 3D APs by level, the mean of those rows that are of some seeds."""
    own = [row for row in rows if row["seed"] in seeds]
    metrics = [f"ap_3d/{KITTI_LEVEL[level]}" for level in LEVELS]
    return [f"{sum(float(row[metric]) for row in own) / len(own):.6f}" for metric in metrics]


def _frustum_row(
    printed: Mapping[Hashable, Any],
    own: Sequence[Mapping[str, Any]],
    default: Sequence[Mapping[str, Any]],
) -> tuple[Cell, ...]:
    """Means of some trials; bold where better than the default's, by the seeds that both have."""
    refined = "Final Refinement" if printed["stage"] == SECOND else ""
    section = str(printed["section"]) or refined
    seeds = {row["seed"] for row in own}
    shared = seeds & {row["seed"] for row in default}
    better = [False] * len(LEVELS)
    if shared:
        pairs = zip(_texts(own, shared), _texts(default, shared), strict=True)
        better = [float(text) > float(base) for text, base in pairs]
    ours = [Cell(text, bold) for text, bold in zip(_texts(own, seeds), better, strict=True)]
    theirs = [
        Cell(str(printed[f"3d_{level}"]), printed[f"3d_{level}_bold"] == "1") for level in LEVELS
    ]
    return Cell(section), Cell(str(printed["setting"])), *ours, *theirs


def stage_ends(sweeps: Sequence[FinishedSweep]) -> list[dict[str, Any]]:
    """Last checkpoints of first stages, and of second ones, with their ``stage``, ``values`` and ``sweep``'s name.

    A first stage that several trials share is one.
    """
    found: dict[tuple[str, str, int], dict[str, Any]] = {}
    for sweep in sweeps:
        for trial in sweep.trials:
            if trial.detector != FCONVNET:
                continue
            own = sweep.scores[sweep.scores["trial"] == trial.key]
            first = (
                own[own["step"] <= trial.plan.first_own_step] if trial.plan.first_own_step else own
            )
            parts = {FIRST: first}
            if trial.plan.first_own_step:
                parts[SECOND] = own
            for stage, rows in parts.items():
                if len(rows):
                    last = select(rows, "last").iloc[0].to_dict()
                    key = trial.plan.stages[0] if stage == FIRST else trial.key
                    values = swept(trial.plan)
                    row = {str(name): value for name, value in last.items()}
                    found.setdefault(
                        (stage, key, trial.seed),
                        row | {"stage": stage, "values": values, "sweep": sweep.name},
                    )
    return list(found.values())


class DetectorsTable(PaperTable):
    """Table 7: the final models of PointRCNN and of Frustum ConvNet, the report's below each; bold: the better."""

    name = "course_report.detectors"
    number = "R7"
    title = "Table 7 of the report."
    is_joint = True
    joint_figure = "report_figure_6"

    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """Its detector and setting; of PointRCNN's the table takes the best."""
        if not trial.first_own_step:
            return None
        values = swept(trial)
        is_final = values == FINAL if trial.detector == FCONVNET else set(values) == {RCNN_BIN}
        return (trial.detector, str(values)) if is_final and trial.detector in NAMES else None

    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """Two rows a detector: ours and the report's."""
        models = {detector: self.models(sweeps, detector) for detector in NAMES}
        models = {
            detector: own
            for detector, own in models.items()
            if len(own) and set(FINAL_METRICS) <= set(own)  # not without the picture
        }
        if not models:
            return None
        texts = {
            detector: [f"{own[metric].mean():.1f}" for metric in FINAL_METRICS]
            for detector, own in models.items()
        }
        printed = {row["method"]: row for row in published_table(self.number).to_dict("records")}
        keys = [f"{level}_{name}" for level in LEVELS for name in METRICS]
        best = [max(float(own[place]) for own in texts.values()) for place in range(len(keys))]
        rows = []
        for detector, own in texts.items():
            ours = [
                Cell(text, len(texts) > 1 and float(text) == best[k]) for k, text in enumerate(own)
            ]
            rows.append((Cell(NAMES[detector]), Cell("ours"), *ours))
            theirs = printed[NAMES[detector]]
            cells = [Cell(str(theirs[key]), theirs[f"{key}_bold"] == "1") for key in keys]
            rows.append((Cell(""), Cell("report"), *cells))
        columns = (
            Column("method", "Method"),
            Column("source", ""),
            *(
                Column(f"{level}_{name}", name, head, True)
                for level, head in LEVELS.items()
                for name in METRICS
            ),
        )
        more = (
            "bbox: PointRCNN's are its boxes' projections, "
            "Frustum ConvNet's the 2D detector's boxes, as in the report."
        )
        legend = "AP in percent; bold: the better of the two"
        caption = "PointRCNN and Frustum ConvNet"
        seeds = seeds_note({NAMES[name]: own["seed"] for name, own in models.items()}, UNPAIRED)
        return Table(
            self.number,
            caption,
            columns,
            tuple(rows),
            legend,
            (*notes, seeds, more),
            title=self.title,
        )

    def models(self, sweeps: Sequence[FinishedSweep], detector: str) -> pd.DataFrame:
        """A detector's final models, a row a seed; of several settings those of the highest mean."""
        parts = []
        for sweep in sweeps:
            settings = {t.key: self.row_of(t.plan) for t in sweep.trials if t.detector == detector}
            last = sweep.select("last")
            last = last.assign(setting=last["trial"].map(settings))
            parts.append(last.dropna(subset="setting"))
        every = pd.concat(parts, ignore_index=True)
        if every.empty:
            return every
        means = every.groupby("setting")["ap_3d/moderate"].mean()
        return every[every["setting"] == means.index[int(means.to_numpy().argmax())]]


FRUSTUM = FrustumTable()
DETECTORS = DetectorsTable()
