"""What of some detectors can be compared: classes, boxes, the view that a verdict is about; and why not the rest."""

from __future__ import annotations

from collections.abc import Sequence

from fl3d.analysis.result_folders import Held
from fl3d.core.errors import ConfigError, options
from fl3d.core.plurals import several
from fl3d.evaluation.average_precision import Comparison

PRIMARY = (
    "3d",
    "bev",
    "image",
)  # the first that can be compared is what verdicts are about, moderate, R40


def primary_view(held: Held, baseline: str, class_name: str) -> str | None:
    """The first of 3D, BEV and 2D that the baseline and another detector have boxes for; None: there is none."""
    own = held.metrics(baseline, class_name)
    others = [held.metrics(name, class_name) for name in held.names if name != baseline]
    return next((m for m in PRIMARY if m in own and any(m in other for other in others)), None)


def comparable_classes(held: Held, baseline: str, asked: Sequence[str]) -> tuple[str, ...]:
    """Classes to compare, written as the protocol does.

    Args:
        held: see ``result_folders.hold``.
        baseline: name of the detector that the others are held against.
        asked: classes, in any case; empty: all that can be compared.

    Raises:
        ConfigError: a class that the protocol has not, or none can be compared.
    """
    known = {name.lower(): name for name in held.protocol.overlaps}
    for name in asked:
        if name.lower() not in known:
            possible = options(name, known.values())
            raise ConfigError(f"--classes {name}: no class of the protocol. {possible}")
    chosen = [known[name.lower()] for name in asked] or list(known.values())
    found = [name for name in dict.fromkeys(chosen) if not _why_not(held, baseline, name)]
    if not found:
        reasons = [_why_not(held, baseline, name) for name in dict.fromkeys(chosen)]
        raise ConfigError(f"nothing to compare. {' '.join(reasons)}")
    return tuple(found)


def _why_not(held: Held, baseline: str, class_name: str) -> str:
    """Why a class is not compared, as a sentence; or nothing."""
    if not held.counts(class_name):
        return f"{class_name} is not compared: no ground truth of it counts."
    if primary_view(held, baseline, class_name):
        return ""
    lacking = [held.lacks(name, class_name) for name in held.names]
    return f"{class_name} is not compared. {' '.join(one for one in lacking if one)}"


def _are_alike(runs: Sequence[Comparison]) -> bool:
    """Whether any two runs have found the same to the digit, and anything at all."""
    digests = [run.det.digest for run in runs if run.det.digest]
    return len(set(digests)) < len(digests)


def notes_on(held: Held, baseline: str, classes: Sequence[str], asked: Sequence[str]) -> list[str]:
    """What is not compared, and which runs have no partner, as sentences.

    Args:
        held: see ``result_folders.hold``.
        baseline: name of the detector that the others are held against.
        classes: that are compared.
        asked: classes that were asked for.
    """
    notes = [held.lacks(name, class_name) for name in held.names for class_name in classes]
    notes += [held.collapsed(name, class_name) for name in held.names for class_name in classes]
    for name in held.names:
        if _are_alike(held.runs[name]):
            notes.append(f"Runs of {name} have the same detections: they are no runs of their own.")
        own, base = len(held.runs[name]), len(held.runs[baseline])
        if own != base:
            shared = f"the first {min(own, base)} of each are paired"
            notes.append(f"{name} has {several(own, 'run')} and {baseline} {base}: {shared}.")
    wanted = {name.lower() for name in asked}
    for class_name in held.protocol.overlaps:
        is_detected = any(held.metrics(name, class_name) for name in held.names)
        if class_name not in classes and (is_detected or class_name.lower() in wanted):
            notes.append(_why_not(held, baseline, class_name))
    return [note for note in notes if note]
