"""A plan as a tree that a person can read. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fl3d.core.records import Stage
from fl3d.sweep.identity import leaves
from fl3d.sweep.plan import Plan


def plan_tree(plan: Plan, note: Callable[[Stage], str]) -> list[str]:
    """Lines of a tree: stages below those they resume from, each with what sets it apart.

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
            is_root = stage.parent is None
            is_last = stage is siblings[-1]
            below = children.get(stage.key, [])
            is_shared = stage.key not in trials and len(below) > 1
            stem = "" if is_root else ("└─ " if is_last else "├─ ")
            mark = " (shared)" if is_shared else ""
            lines.append(f"{indent}{stem}{names[stage.key]}{mark}: {note(stage)}")
            deeper = "" if is_root else ("   " if is_last else "│  ")
            draw(below, indent + deeper)

    draw(children.get(None, []), "")
    return lines


def labels(siblings: list[Stage]) -> Mapping[str, str]:
    """What sets each of some stages apart: detector, name, and values that differ within these."""
    values = {stage.key: dict(leaves(stage.config)) for stage in siblings}
    seen: dict[tuple[str, str], dict[str, set[str]]] = {}
    for stage in siblings:
        texts = seen.setdefault((_target(stage), stage.name), {})
        for key, value in values[stage.key].items():
            texts.setdefault(key, set()).add(repr(value))
    found = {}
    for stage in siblings:
        texts = seen[_target(stage), stage.name]
        own = sorted(values[stage.key].items())
        differing = [f"{key}={value}" for key, value in own if len(texts[key]) > 1]
        detector = [stage.class_name] if stage.parent is None else []
        found[stage.key] = " ".join([*detector, stage.name, *differing])
    return found


def _target(stage: Stage) -> str:
    return f"{stage.target} {stage.class_name}"
