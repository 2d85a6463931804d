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
    values = {stage.key: dict(leaves(stage.config)) for stage in siblings}
    seen: dict[tuple[str, str], dict[str, set[str]]] = {}
    for stage in siblings:
        texts = seen.setdefault((_target(stage), stage.name), {})
        for key, value in values[stage.key].items():
            texts.setdefault(key, set()).add(repr(value))
    found = {}
    for stage in siblings:
        texts = seen[_target(stage), stage.name]
        told = [f"{key}={value}" for key, value in sorted(values[stage.key].items()) if len(texts[key]) > 1]
        detector = [_target(stage).rsplit(".", 1)[-1]] if stage.parent is None else []
        found[stage.key] = " ".join([*detector, stage.name, *told])
    return found


def _target(stage: Stage) -> str:
    return str(stage.config["detector"]["_target_"])
