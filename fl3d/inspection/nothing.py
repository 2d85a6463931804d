"""What would make training or evaluation come to nothing: no targets, no points, no object that counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from fl3d.core.errors import DataError
from fl3d.data.labels import Labels
from fl3d.evaluation.counts import LabelCounts, count_labels
from fl3d.evaluation.scoring import ground_truths
from fl3d.inspection.facts import Facts
from fl3d.inspection.finding import Finding, error
from fl3d.inspection.wanted import Wanted
from fl3d.reports.uncounted import why_no_label


def of_nothing(facts: Facts, train: str, val: str) -> Iterator[Finding]:
    """Errors: nothing to learn from in one split, nothing that counts in the other.

    Args:
        facts: of the folder.
        train: split that is learnt from.
        val: split that is evaluated.
    """
    for wanted in facts.wanted:
        if not facts.looked_at(train) or not facts.labels(train):
            continue  # what cannot be read is said already
        if not any(facts.clouds[i].in_range[wanted.detector] for i in facts.looked_at(train)):
            yield error(_no_points(facts, train, wanted), "Are axes and units right?")
        if not facts.targets(train, wanted):
            yield error(_no_targets(facts, train, wanted), _why_no_targets(facts, train, wanted))
    for name in facts.protocol.classes:
        counts = counted(facts, val, [name])
        if counts is not None and counts.is_empty:
            yield error(f"nothing counts in split {val}: {why_no_label(counts, facts.protocol)}")


def counted(facts: Facts, split: str, classes: Sequence[str] | None = None) -> LabelCounts | None:
    """What counts of a split under the protocol; None where a cloud that its difficulty goes by cannot be read."""
    validation = facts.validations[split]
    if not validation.ids:
        return None
    try:
        gt, beyond, points = ground_truths(validation, facts.protocol)
    except DataError:  # said already
        return None
    return count_labels(gt, facts.protocol, classes, beyond, points)


def classes_of(labels: list[Labels]) -> dict[str, int]:
    """Objects by class, most first."""
    found = Counter(str(name) for of in labels for name in of.types)
    return dict(found.most_common())


def listed(classes: Mapping[str, int], most: int = 12) -> str:
    """``Car 6632, Van 758``; the most frequent ones."""
    some = [f"{name} {n}" for name, n in list(classes.items())[:most]]
    return ", ".join(some + ["..."] * (len(classes) > most)) or "none"


def _no_points(facts: Facts, split: str, wanted: Wanted) -> str:
    frames = facts.looked_at(split)
    points = sum(facts.clouds[i].points for i in frames)
    kept = sum(facts.clouds[i].kept for i in frames)
    return (
        f"{wanted.detector} sees no point: of {points} points in {len(frames)} training frames {kept} are kept by "
        f"data.crop={facts.kitti.crop}, and none of those is in its range {_range(wanted)}."
    )


def _range(wanted: Wanted) -> str:
    if wanted.range_velo is None:
        return "(all)"
    x0, y0, z0, x1, y1, z1 = wanted.range_velo
    return f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g}, z {z0:g} to {z1:g} m"


def _no_targets(facts: Facts, split: str, wanted: Wanted) -> str:
    names = " or ".join(wanted.classes)
    frames = facts.looked_at(split)
    return (
        f"{wanted.detector} has nothing to learn: in {len(frames)} training frames no label of class {names} holds "
        f"{wanted.min_points} or more points and lies in its range."
    )


def _why_no_targets(facts: Facts, split: str, wanted: Wanted) -> str:
    """The first cause that holds."""
    labels = facts.labels(split)
    there = {name: n for name, n in classes_of(labels).items() if name != "DontCare"}
    own = {name: n for name, n in there.items() if name in wanted.classes}
    if not there:
        return f"All {len(labels)} label files are empty."
    if not own:
        return f"There are labels of these classes: {listed(there)}."
    total = sum(own.values())
    held = [facts.clouds[i].held[_own_rows(facts, i, wanted)] for i in facts.looked_at(split)]
    most = max((int(points.max()) for points in held if len(points)), default=0)
    return f"There are {total} such labels; the fullest of those looked at holds {most} points."


def _own_rows(facts: Facts, frame_id: str, wanted: Wanted) -> list[int]:
    labels = facts.beside[frame_id].labels
    if labels is None:
        return []
    return [k for k, name in enumerate(labels.types) if name in wanted.classes]
