"""What an evaluation of a folder counted, what it did not count, and why. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from fl3d.evaluation.average_precision import Curves, most_possible
from fl3d.evaluation.folders import Evaluated
from fl3d.evaluation.levels import MAX_OCCLUSION, MAX_TRUNCATION, MIN_HEIGHT, Reason
from fl3d.evaluation.protocol import Protocol
from fl3d.reports.evaluated import shown_levels

FULL = 100.0
SHOWN = 8  # names of classes that are listed


def count_lines(found: Evaluated) -> list[str]:
    """What was counted and what was not, as a Markdown list; nothing is told whose count is 0."""
    several = len(shown_levels(found.protocol)) > 1
    order = ", easy/moderate/hard" if several else ""
    labels, results = _label_lines(found), _result_lines(found)
    lines = [f"n_gt: ground truths that count{order}."] if not found.labels.is_empty else []
    lines += _frame_lines(found)
    if labels:
        lines += [f"Labels that do not count{order}:", *(f"- {line}" for line in labels)]
    if results:
        lines += [f"Results that do not count{order}:", *(f"- {line}" for line in results)]
    return [*lines, *cap_lines(found.curves, found.protocol)]


def _frame_lines(found: Evaluated) -> list[str]:
    frames, lines = found.frames, []
    if frames.missing:
        of = "frames of the split" if frames.split else "labels"
        is_out = not frames.missing & set(frames.ids)
        fate = (
            "left out (--missing empty counts them as frames in which nothing was found)"
            if is_out
            else "counted as frames in which nothing was found"
        )
        lines.append(f"{len(frames.missing)} of {frames.wanted} {of} have no result file: {fate}.")
    if frames.passed_over:
        names = listed(frames.passed_over)
        lines.append(f"No result files of frames, passed over: {names}.")
    return lines


def _label_lines(found: Evaluated) -> list[str]:
    counts, protocol = found.labels, found.protocol
    lines = _reason_lines(counts.ignored, protocol, {})
    near = [
        f"{neighbour} {n} (for {name})"
        for name, of in counts.neighbours.items()
        for neighbour, n in of.items()
        if n
    ]
    if near:
        lines.append(f"neither hits nor misses: {', '.join(near)}")
    if counts.others:
        lines.append(f"other classes: {by_name(counts.others)}")
    if counts.dontcare:
        effect = (
            "false alarms in them do not count in the image metric"
            if protocol.uses_picture
            else "of no effect without the picture"
        )
        lines.append(f"DontCare regions: {counts.dontcare}; {effect}")
    return lines


def _reason_lines(
    ignored: Mapping[str, Mapping[str, Mapping[Reason, int]]],
    protocol: Protocol,
    texts: Mapping[Reason, str],
) -> list[str]:
    """A line a class: how many at each level, and why."""
    lines = []
    for name, by_level in ignored.items():
        parts = []
        for reason in Reason:
            numbers = [by_level[level].get(reason, 0) for level in shown_levels(protocol)]
            if any(numbers):
                why = texts.get(reason, reason_text(reason, protocol))
                parts.append(f"{_joined(numbers)} {why}")
        if parts:
            lines.append(f"{name}: {'; '.join(parts)}")
    return lines


def _result_lines(found: Evaluated) -> list[str]:
    counts = found.results
    lowest = {Reason.LOW: f"lower than {slashed(MIN_HEIGHT)} px"}  # of results, in both variants
    lines = _reason_lines(counts.ignored, found.protocol, lowest)
    if counts.others:
        lines.append(f"other classes: {by_name(counts.others)}")
    return lines


def reason_text(reason: Reason, protocol: Protocol) -> str:
    """A reason with the protocol's limits: ``occluded more than 0/1/2``."""
    low = "lower than" if protocol.variant == "A" else "not higher than"
    limits = protocol.level_limits or ()
    texts = {
        Reason.NO_BOX: "without a 2D box",
        Reason.LOW: f"{low} {slashed(MIN_HEIGHT)} px",
        Reason.OCCLUDED: f"occluded more than {slashed(MAX_OCCLUSION)}",
        Reason.TRUNCATED: f"truncated more than {slashed(MAX_TRUNCATION)}",
        Reason.FAR: f"further away than {slashed(limits)} m",
        Reason.FEW_POINTS: f"with fewer than {slashed(limits)} points",
    }
    return texts.get(reason, str(reason))


def cap_lines(curves: Curves, protocol: Protocol) -> list[str]:
    """Where so few ground truths count that AP cannot reach 100."""
    by_number: dict[int, list[str]] = {}
    levels = shown_levels(protocol)
    for name, metrics in curves.items():
        own = metrics[protocol.metrics[-1]]
        few: dict[int, list[str]] = {}
        for level, called in levels.items():
            n = own[level].n_gt
            if n and most_possible(n) != (FULL, FULL):
                few.setdefault(n, []).append(called)
        for number, own_levels in few.items():
            by_number.setdefault(number, []).append(f"{name} {', '.join(own_levels)}")
    lines = []
    for number, cells in sorted(by_number.items()):
        r11, r40 = most_possible(number)
        truths = "ground truth" if number == 1 else "ground truths"
        lines.append(
            f"{'; '.join(cells)}: {number} {truths}: {r11:.2f} (R11) and {r40:.2f} (R40) are the "
            "most that KITTI's rule can give."
        )
    return lines


def by_name(counts: Mapping[str, int]) -> str:
    """``Vehicle 12, Truck 3``, most first."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return listed([f"{name} {n}" for name, n in ordered])


def listed(names: Sequence[str]) -> str:
    """The first of some names, and how many there are more."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def slashed(values: Iterable[float]) -> str:
    """``40/25/25``."""
    return "/".join(f"{value:g}" for value in values)


def _joined(numbers: Sequence[int]) -> str:
    """Counts of the levels; one where they are all the same."""
    return str(numbers[0]) if len(set(numbers)) == 1 else slashed(numbers)
