"""Tables 6 and 7 of the course report: AP of Frustum ConvNet by setting, and of both detectors. Pure.

They are fed by several sweeps: rows are found among all scores by what the trials' overrides say.
"""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from fl3d.reports.published import published_table
from fl3d.reports.selection import select
from fl3d.reports.table import Cell, Column, Table

LEVELS = {"easy": "Easy", "medium": "Medium", "hard": "Hard"}
KITTI_LEVEL = {"easy": "easy", "medium": "moderate", "hard": "hard"}
METRICS = {"bbox": "image", "bev": "bev", "3d": "3d"}
FCONVNET, POINTRCNN = "F-ConvNet", "PointRCNN"
FIRST, SECOND = "first", "refinement"
# What a row's trial is, by stage and printed setting.
SETTINGS: Mapping[tuple[str, str], str] = {
    (FIRST, "Default Parameters"): "loss.alpha=0.25",
    (FIRST, "Batch Size = 64"): "schedule.batch_size=8",
    (FIRST, "Batch Size = 8"): "schedule.batch_size=1",
    (FIRST, "s and u_half = 1,2,4,8"): "detector.slabs={stride:[1.0,2.0,4.0,8.0],half:[1.0,2.0,4.0,8.0]}",
    (FIRST, "s and u_half = 0.5,1,2,4"): "detector.slabs={stride:[0.5,1.0,2.0,4.0],half:[0.5,1.0,2.0,4.0]}",
    (FIRST, "Alpha = 0.2"): "loss.alpha=0.2",
    (FIRST, "Alpha = 0.3"): "loss.alpha=0.3",
    (FIRST, "Head_REG Weight = 30"): "detector.weights={yaw:30.0}",
    (FIRST, "Heading_class loss multiplier = 1.5"): "detector.weights={yaw_bin:1.5}",
    (SECOND, "Default Parameters"): "loss.alpha=0.25",
    (SECOND, "Our Final Parameters"): "loss.alpha=0.3",
}
FINAL = SETTINGS[SECOND, "Our Final Parameters"]
RCNN = r"detector\.rcnn\.bin=\S+$"
NAMES = {POINTRCNN: "PointRCNN", FCONVNET: "Frustum ConvNet"}


def frustum_table(scores: pd.DataFrame, notes: tuple[str, ...] = ()) -> Table:
    """Table 6: 3D AP of Frustum ConvNet, settings that were not run left out; bold: better than its stage's default.

    Args:
        scores: tidy, of all sweeps that feed it.
        notes: put below.
    """
    own = _without_seeds(scores[scores["detector"] == FCONVNET])
    ends = _stage_ends(own)
    rows: list[tuple[Cell, ...]] = []
    base: dict[str, dict[str, str]] = {}
    for printed in published_table("R6").to_dict("records"):
        stage, setting = str(printed["stage"]), str(printed["setting"])
        found = ends[(ends["stage"] == stage) & (ends["overrides"] == SETTINGS[stage, setting])]
        if found.empty:
            continue
        values = {level: f"{found[f'ap_3d/{KITTI_LEVEL[level]}'].mean():.6f}" for level in LEVELS}
        default = base.setdefault(stage, values) if setting == "Default Parameters" else base.get(stage)
        bold = {level: default is not None and float(values[level]) > float(default[level]) for level in LEVELS}
        section = str(printed["section"]) or ("Final Refinement" if stage == SECOND else "")
        ours = [Cell(values[level], bold[level]) for level in LEVELS]
        theirs = [Cell(str(printed[f"3d_{level}"]), printed[f"3d_{level}_bold"] == "1") for level in LEVELS]
        rows.append((Cell(section), Cell(setting), *ours, *theirs))
    columns = (
        Column("section", ""),
        Column("setting", "Setting"),
        *(Column(f"3d_{level}", head, "3D AP, ours", True) for level, head in LEVELS.items()),
        *(Column(f"3d_{level}_published", head, "3D AP, report", True) for level, head in LEVELS.items()),
    )
    legend = "AP in percent; bold: better than the default of the same stage"
    return Table("R6", "Frustum ConvNet by setting: last models", columns, tuple(rows), legend, notes)


def _stage_ends(scores: pd.DataFrame) -> pd.DataFrame:
    """Last checkpoints of first stages, and of second ones; a stage that two sweeps share is one."""
    second = select(scores[scores["first_own_step"] > 0], "last").assign(stage=SECOND)
    before = scores[(scores["first_own_step"] > 0) & (scores["step"] <= scores["first_own_step"])]
    alone = scores[scores["first_own_step"] == 0]
    first = [select(part, "last") for part in (alone, before)]
    ends = pd.concat([*(part.assign(stage=FIRST) for part in first), second], ignore_index=True)
    return ends.drop_duplicates(["stage", "overrides", "seed"])


def detectors_table(scores: pd.DataFrame, notes: tuple[str, ...] = ()) -> Table:
    """Table 7: PointRCNN's best second stage and Frustum ConvNet's final one; bold: the better of the two.

    Args:
        scores: tidy, of all sweeps that feed it.
        notes: put below.
    """
    last = _without_seeds(select(scores[scores["first_own_step"] > 0], "last"))
    chosen = {}
    for detector, own in last.groupby("detector"):
        final = own[own["overrides"] == FINAL] if detector == FCONVNET else own[own["overrides"].str.match(RCNN)]
        means = final.groupby("overrides")[[f"ap_{metric}/{level}" for metric, level in _cells()]].mean()
        if detector in NAMES and len(means):
            chosen[str(detector)] = means.iloc[int(means["ap_3d/moderate"].to_numpy().argmax())]
    printed = {row["method"]: row for row in published_table("R7").to_dict("records")}
    keys = [f"{level}_{name}" for level in LEVELS for name in METRICS]
    texts = {d: [f"{row[f'ap_{metric}/{level}']:.1f}" for metric, level in _cells()] for d, row in chosen.items()}
    rows = []
    for detector in NAMES:
        if detector not in texts:
            continue
        best = [max(float(other[i]) for other in texts.values()) for i in range(len(keys))]
        ours = [Cell(t, len(texts) > 1 and float(t) == best[i]) for i, t in enumerate(texts[detector])]
        rows.append((Cell(NAMES[detector]), Cell("ours"), *ours))
        theirs = printed[NAMES[detector]]
        rows.append((Cell(""), Cell("report"), *(Cell(str(theirs[key]), theirs[f"{key}_bold"] == "1") for key in keys)))
    columns = (
        Column("method", "Method"),
        Column("source", ""),
        *(Column(f"{level}_{name}", name, head, True) for level, head in LEVELS.items() for name in METRICS),
    )
    more = "bbox: PointRCNN's are its boxes' projections, Frustum ConvNet's the 2D detector's boxes, as in the report."
    legend = "AP in percent; bold: the better of the two"
    return Table("R7", "PointRCNN and Frustum ConvNet", columns, tuple(rows), legend, (*notes, more))


def _without_seeds(scores: pd.DataFrame) -> pd.DataFrame:
    """Scores whose overrides tell all but the seed."""
    told = scores["overrides"].astype(str).str.replace(r"\s*\bseed=\S+", "", regex=True).str.strip()
    return scores.assign(overrides=told)


def _cells() -> list[tuple[str, str]]:
    return [(metric, KITTI_LEVEL[level]) for level in LEVELS for metric in METRICS.values()]
