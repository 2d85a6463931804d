"""What a check found, as lines for a terminal and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fl3d.core.errors import DataError
from fl3d.evaluation.protocol import DIFFICULTIES
from fl3d.inspection.calibrations import of_calibrations, of_pictures
from fl3d.inspection.clouds import of_clouds, of_image_boxes
from fl3d.inspection.facts import Facts
from fl3d.inspection.finding import Finding, Severity, of_problems
from fl3d.inspection.fit import of_fit
from fl3d.inspection.labels import of_labels
from fl3d.inspection.nothing import classes_of, counted, listed, of_nothing
from fl3d.inspection.splits import of_area, of_splits
from fl3d.inspection.wanted import Wanted


@dataclass(frozen=True)
class Checked:
    """What a check came to.

    Args:
        findings: errors first.
        lines: three of them: what is learnt from, what is evaluated, what networks see.
    """

    findings: tuple[Finding, ...]
    lines: tuple[str, ...]

    @property
    def errors(self) -> list[Finding]:
        """Those findings that stop a sweep."""
        return [one for one in self.findings if one.severity is Severity.ERROR]


def checked(facts: Facts, train: str, val: str, problems: Sequence[DataError] = ()) -> Checked:
    """Look for everything that is wrong or odd.

    Args:
        facts: of the folder.
        train: split that is learnt from.
        val: split that is evaluated.
        problems: of the splits themselves.
    """
    found = [
        *of_problems([*problems, *facts.problems]),
        *of_nothing(facts, train, val),
        *of_splits(facts, train, val, train == val and not problems),
        *of_area(facts),
        *of_calibrations(facts),
        *of_clouds(facts),
        *of_labels(facts),
        *of_fit(facts),
        *of_pictures(facts),
        *of_image_boxes(facts),
    ]
    order = [one for severity in Severity for one in found if one.severity is severity]
    return Checked(
        tuple(order), (train_line(facts, train), val_line(facts, val), points_line(facts, train))
    )


def train_line(facts: Facts, split: str) -> str:
    """``learnt from (train): 1200 frames; of 897 labels of class Car in 200 of them, 627 are targets of VoxelNet``."""
    n, looked = len(facts.splits[split]), len(facts.looked_at(split))
    text = f"learnt from ({split}): {n} frames"
    if not looked:
        classes = classes_of(facts.labels(split))
        return f"{text}; labels: {listed(classes)}"
    same: dict[tuple[str, int, int], list[str]] = {}
    for one in facts.wanted:
        what = " and ".join(one.classes), facts.objects(split, one), facts.targets(split, one)
        same.setdefault(what, []).append(one.detector)
    where = "" if looked == n else f" in {looked} of them"
    for (classes_text, objects, targets), names in same.items():
        of = f"of {objects} labels of class {classes_text}{where}"
        text += f"; {of}, {targets} are targets of {', '.join(names)}"
    return text


def val_line(facts: Facts, split: str) -> str:
    """``evaluated (val): 300 frames; count: Car 333 easy, 751 moderate, 1046 hard of 1332 (protocol paper)``."""
    text = f"evaluated ({split}): {len(facts.splits[split])} frames"
    counts = counted(facts, split)
    if counts is None:
        return f"{text} (protocol {facts.protocol.name})"
    told = [
        f"{name} {', '.join(f'{levels[level]} {level}' for level in DIFFICULTIES)} of {counts.labels[name]}"
        for name, levels in counts.counted.items()
        if counts.labels[name]
    ]
    return f"{text}; count: {'; '.join(told) or 'nothing'} (protocol {facts.protocol.name})"


def points_line(facts: Facts, split: str) -> str:
    """``points: 27,030 a frame, 19,422 of them in the picture; in range: 17,678 (VoxelNet)``."""
    clouds = [facts.clouds[i] for i in facts.looked_at(split)]
    if not clouds:
        return "points: no cloud was looked at"
    mean = np.mean([cloud.points for cloud in clouds])
    kept = np.mean([cloud.kept for cloud in clouds])
    crop = f", {kept:,.0f} of them in the picture" if facts.kitti.crop == "image" else ""
    networks = {one.detector.partition(":")[0]: one.detector for one in facts.wanted}
    ranges = [
        f"{np.mean([cloud.in_range[own] for cloud in clouds]):,.0f} ({name})"
        for name, own in networks.items()
    ]
    seen = f"; in range: {', '.join(ranges)}" if ranges else ""
    return f"points: {mean:,.0f} a frame{crop}{seen}"


def overview(facts: Facts) -> list[tuple[str, str]]:
    """What lies in the folder: heading and text of each line."""
    frames = list(facts.beside.values())
    classes = classes_of([one.labels for one in frames if one.labels is not None])
    clouds = list(facts.clouds.values())
    endings = Counter(one.picture or "none" for one in frames)
    sizes = Counter(one.image_size for one in frames if one.image_size is not None)
    rows = [
        ("splits", ", ".join(f"{name} {len(ids)}" for name, ids in facts.splits.items())),
        ("labels", listed(classes)),
        ("pictures", ", ".join(f"{n} {ending.lstrip('.')}" for ending, n in endings.most_common())),
        ("sizes", ", ".join(f"{n} of {w} x {h}" for (w, h), n in sizes.most_common(5))),
    ]
    if clouds:
        points = [cloud.points for cloud in clouds]
        low = min(cloud.reflectance[0] for cloud in clouds)
        high = max(cloud.reflectance[1] for cloud in clouds)
        reach = np.median([cloud.reach for cloud in clouds])
        text = f"{len(clouds)} looked at: {min(points):,} to {max(points):,} points, 95 % within {reach:.3g} m"
        rows.append(("clouds", f"{text}; reflectance {low:.3g} to {high:.3g}"))
    boxes = facts.kitti.image_boxes
    rows.append(("2D detections", "none" if boxes is None else f"of {len(boxes)} frames"))
    return rows


def start_texts(result: Checked, root: Path) -> dict[str, list[str]]:
    """What a sweep says of its data when it starts."""
    return {
        "lines": list(result.lines),
        "errors": [one.text(root) for one in result.errors],
        "warnings": [one.text(root) for one in result.findings if one not in result.errors],
    }


def as_json(facts: Facts, result: Checked) -> dict[str, Any]:
    """Everything that was found, as values of JSON."""
    findings = []
    for one in result.findings:
        values = asdict(one)
        values["file"] = None if one.file is None else str(one.file)
        findings.append(values)
    counts = {split: counted(facts, split) for split in facts.splits}
    return {
        "root": str(facts.kitti.root),
        "overview": dict(overview(facts)),
        "lines": list(result.lines),
        "classes": {split: classes_of(facts.labels(split)) for split in facts.splits},
        "targets": {
            split: {_name(facts, one): facts.targets(split, one) for one in facts.wanted}
            for split in facts.splits
        },
        "counted": {split: None if of is None else asdict(of) for split, of in counts.items()},
        "findings": findings,
    }


def _name(facts: Facts, wanted: Wanted) -> str:
    """A detector's, with what it learns from where the sweep has it learn from something else too."""
    if [one.detector for one in facts.wanted].count(wanted.detector) == 1:
        return wanted.detector
    return f"{wanted.detector}: {' and '.join(wanted.classes)} of {wanted.min_points} points on"
