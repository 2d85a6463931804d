"""A plan as a tree that a person can read. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fl3d.records import Stage
from fl3d.sweep.identity import leaves
from fl3d.sweep.plan import Plan


def plan_tree(plan: Plan, note: Callable[[Stage], str]) -> list[str]:
    """Lines of a tree: stages below those they go on from, each with what sets it apart from its siblings.

    Args:
        plan: of a sweep.
        note: what is said of a stage behind its name.
    """
    children: dict[str | None, list[Stage]] = {}
    for stage in plan.stages.values():
        children.setdefault(stage.parent, []).append(stage)
    trials = {trial.key for trial in plan.trials}
    lines: list[str] = []

    def draw(siblings: list[Stage], indent: str) -> None:
        names = labels(siblings)
        for stage in siblings:
            is_last = stage is siblings[-1]
            stem = "" if stage.parent is None else ("└─ " if is_last else "├─ ")
            mark = "" if stage.key in trials else " (shared)" if len(children.get(stage.key, [])) > 1 else ""
            lines.append(f"{indent}{stem}{names[stage.key]}{mark}: {note(stage)}")
            deeper = indent if stage.parent is None else indent + ("   " if is_last else "│  ")
            draw(children.get(stage.key, []), deeper)

    draw(children.get(None, []), "")
    return lines


def labels(siblings: list[Stage]) -> Mapping[str, str]:
    """What sets each of some stages apart: its detector, its name, and the values that differ within the detector."""
    found = {}
    for stage in siblings:
        kin = [other for other in siblings if _target(other) == _target(stage) and other.name == stage.name]
        values = [dict(leaves(other.config)) for other in kin]
        varied = {key for own in values for key in own if len({repr(one.get(key)) for one in values}) > 1}
        own = dict(leaves(stage.config))
        told = [f"{key}={own[key]}" for key in sorted(varied) if key in own]
        detector = [_target(stage).rsplit(".", 1)[-1]] if stage.parent is None else []
        found[stage.key] = " ".join([*detector, stage.name, *told])
    return found


def _target(stage: Stage) -> str:
    return str(stage.config["detector"]["_target_"])
