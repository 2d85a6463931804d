"""What a reader must know of a table's APs: data, classes, overlaps, cuts."""

from __future__ import annotations

from fl3d.config.settings import Settings
from fl3d.data.classes import CARS
from fl3d.evaluation.protocol import METRICS, Protocol


def protocol_note(
    settings: Settings,
    average: str = "R11",
    of_results: bool = False,
    class_name: str | None = None,
) -> str:
    """What a reader must know of a table's APs.

    Args:
        settings: of the sweep.
        average: R11 or R40.
        of_results: whether they are of result files, which programs have suppressed themselves.
        class_name: of several classes the one that they are of; None: the one class, or the mean.
    """
    protocol = settings.protocol
    classes = protocol.classes if class_name is None else (class_name,)
    overlaps = [_overlaps_text(protocol, name) for name in classes]
    if len(classes) > 1:
        overlaps = [f"{text} for {name}" for text, name in zip(overlaps, classes, strict=True)]
    mean = classes[0] if len(classes) == 1 else f"mean over {', '.join(classes)}"
    what = "cars" if classes == CARS else "objects"
    names = " / ".join({"image": "image", "bev": "BEV", "3d": "3D"}[m] for m in protocol.metrics)
    levels = "" if protocol.uses_picture else f"; objects all around, {protocol.levels_text}"
    area = protocol.ignore_beyond
    limit = (
        f"; {what} beyond x {area[0]:g} to {area[2]:g} m, y {area[1]:g} to {area[3]:g} m ignored"
        if area
        else ""
    )
    suppression = "NMS as the programs did it" if of_results else f"NMS {protocol.nms_iou:g}"
    return (
        f"Data {settings.data.name}, profile {settings.profile}; {mean}, {average}, overlaps {', '.join(overlaps)} "
        f"({names}){levels}; score cut {protocol.score_threshold:g}, {suppression}{limit}."
    )


def _overlaps_text(protocol: Protocol, name: str) -> str:
    of_metric = dict(zip(METRICS, protocol.overlaps[name], strict=True))
    return " / ".join(f"{of_metric[metric]:g}" for metric in protocol.metrics)
