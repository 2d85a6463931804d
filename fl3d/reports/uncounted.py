"""Why an evaluation has nothing to count, and what looks like a mistake. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from fl3d.core.errors import meant
from fl3d.evaluation.counts import LabelCounts, ResultCounts
from fl3d.evaluation.folders import Evaluated
from fl3d.evaluation.frames import LABEL_FIELDS
from fl3d.evaluation.levels import MAX_OCCLUSION, MAX_TRUNCATION, MIN_HEIGHT, Reason
from fl3d.evaluation.mistakes import Mistake
from fl3d.evaluation.protocol import DIFFICULTIES, Protocol
from fl3d.reports.counted import by_name

# Classes of KITTI's benchmark, which every named protocol scores: that a data set has none of one is no slip.
USUAL = ("Car", "Pedestrian", "Cyclist")
OF_PICTURE = {
    Reason.NO_BOX,
    Reason.LOW,
    Reason.NO_OCCLUSION,
    Reason.OCCLUDED,
    Reason.NO_TRUNCATION,
    Reason.TRUNCATED,
}


def warnings(found: Evaluated) -> list[str]:
    """What looks like a mistake, though numbers come of it."""
    labels, results = found.labels, found.results
    lines = [*_turned("labels", labels.turned), *_turned("results", results.turned)]
    sizes = (("labels", labels.without_size), ("results", results.without_size))
    for what, without in sizes:
        for name, number in without.items():
            lines.append(
                f"none of the {number} {what} of {name} has a 3D box: its bev and 3d are 0"
            )
    lines += _equal_scores(results)
    if found.label_fields > LABEL_FIELDS:
        lines.append(
            f"labels have {found.label_fields} fields a line, not {LABEL_FIELDS}: are they results (with a score) or "
            "tracks? What is behind rotation_y was left out"
        )
    if not results.n_results:
        lines.append("the result files hold no detection")
    none = [
        name
        for name, n in results.results.items()
        if results.n_results and not n and any(labels.counted[name].values())
    ]
    if none and any(results.results.values()):
        lines.append(f"no result is a {' or '.join(none)}, of which there are labels")
    lines += unknown_classes(labels, [results])
    return [*lines, *(mistake.text for mistake in found.mistakes)]


def mistakes_of(found: Evaluated) -> list[str]:
    """What looks like a mistake in how labels or results were written, whatever classes there are."""
    turned = [*_turned("labels", found.labels.turned), *_turned("results", found.results.turned)]
    return [*turned, *_equal_scores(found.results), *(one.text for one in found.mistakes)]


def label_warnings(labels: LabelCounts, results: Sequence[ResultCounts]) -> list[str]:
    """What looks like a mistake in labels that several folders of results are held against, and in asked classes."""
    return [*_turned("labels", labels.turned), *unknown_classes(labels, results)]


def unknown_classes(labels: LabelCounts, results: Sequence[ResultCounts]) -> list[str]:
    """Classes that a user added to a protocol and that nothing is of: a slip, which would change nothing."""
    present = {name for name, n in labels.labels.items() if n} | set(labels.others)
    present |= {name for of in labels.neighbours.values() for name, n in of.items() if n}
    for one in results:
        present |= {name for name, n in one.results.items() if n} | set(one.others)
    return [
        f"no label or result is of class {name}, so its overlaps change nothing. {meant(name, present)}"
        f"There are: {', '.join(sorted(present)) or 'none'}"
        for name in labels.labels
        if name not in (*USUAL, *present)
    ]


def result_warnings(results: ResultCounts, mistakes: Sequence[Mistake]) -> list[tuple[str, str]]:
    """Kind and text of what looks like a mistake in one of several folders of results."""
    lines = [("turned", line) for line in _turned("results", results.turned)]
    lines += [("equal", line) for line in _equal_scores(results)]
    return [*lines, *((f"{one.kind} of {one.class_name}", one.text) for one in mistakes)]


def _turned(what: str, n: int) -> list[str]:
    return [f"rotation_y of {n} {what} is beyond 2 pi: degrees? KITTI's are radians"] if n else []


def _equal_scores(results: ResultCounts) -> list[str]:
    return [
        f"all {results.results[name]} results of {name} have the score {score:g}: their order, and so the curve, says "
        "nothing"
        for name, score in results.equal.items()
    ]


def why_nothing(found: Evaluated) -> str | None:
    """Why no AP can be told, and what one could do; None where one can."""
    if found.labels.is_empty:
        return f"nothing to evaluate: {why_no_label(found.labels, found.protocol)}"
    results, classes = found.results, found.protocol.overlaps
    n_own = sum(results.results.values())
    if results.n_results and not n_own:
        return (
            f"nothing to evaluate: no result is of a class that counts. {_meant(classes, results.others)}"
            f"Found: {by_name(results.others)}; possible: {', '.join(classes)}"
        )
    if found.protocol.uses_picture and n_own and results.without_box == n_own:
        return (
            f"nothing to evaluate: none of {n_own} results has a 2D box, and what is lower than {MIN_HEIGHT[-1]} px "
            "is ignored. Without the picture: --protocol lidar"
        )
    return None


def why_no_label(counts: LabelCounts, protocol: Protocol) -> str:
    """Why no label counts, and what one could do.

    Args:
        counts: of labels of which none counts.
        protocol: that they were counted under.
    """
    if not counts.n_labels:
        return f"the labels of {counts.n_frames} frames hold no object"
    names = ", ".join(counts.counted)
    total = sum(counts.labels.values())
    if not total:
        present = dict(counts.others)
        present |= {name: n for of in counts.neighbours.values() for name, n in of.items() if n}
        present |= {"DontCare": counts.dontcare} if counts.dontcare else {}
        hint = _meant(counts.counted, present)
        return f"no label is of a class that counts. {hint}Found: {by_name(present)}; possible: {names}"
    at_hard: dict[Reason, int] = {}
    for by_level in counts.ignored.values():
        for reason, n in by_level[DIFFICULTIES[-1]].items():
            at_hard[reason] = at_hard.get(reason, 0) + n
    parts = [f"{n} {_at_hard(reason, protocol)}" for reason, n in at_hard.items()]
    return f"of {total} labels ({_present(counts)}) none counts: {', '.join(parts)}. {_advice(at_hard)}"


def _meant(classes: Iterable[str], found: Iterable[str]) -> str:
    """A class of the user's own that is nearly one that is there; of KITTI's, what is there says enough."""
    return "".join(meant(name, found) for name in classes if name not in USUAL)


def _present(counts: LabelCounts) -> str:
    return by_name({name: n for name, n in counts.labels.items() if n})


def _at_hard(reason: Reason, protocol: Protocol) -> str:
    """A reason with the limit of the level that holds most."""
    texts = {
        Reason.NO_BOX: f"without a 2D box, so lower than {MIN_HEIGHT[-1]} px",
        Reason.LOW: f"lower than {MIN_HEIGHT[-1]} px",
        Reason.OCCLUDED: f"occluded more than {MAX_OCCLUSION[-1]}",
        Reason.TRUNCATED: f"truncated more than {MAX_TRUNCATION[-1]}",
    }
    if protocol.level_limits is not None:
        texts[Reason.FAR] = f"further away than {protocol.level_limits[-1]:g} m"
        texts[Reason.FEW_POINTS] = f"with fewer than {protocol.level_limits[-1]:g} points"
    return texts.get(reason, str(reason))


def _advice(reasons: Mapping[Reason, int]) -> str:
    if set(reasons) & OF_PICTURE:
        return (
            "Without the picture, by distance, whatever the occlusion and truncation: protocol lidar "
            "(evaluate: --protocol lidar)"
        )
    if Reason.OUTSIDE in reasons:
        return "protocol.ignore_beyond is the area"
    return "Other levels: protocol.limits=[...], or protocol.difficulty=none for all"
