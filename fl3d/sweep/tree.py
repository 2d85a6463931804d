"""A plan as a tree that a person can read. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from fl3d.core.nested import leaves
from fl3d.core.records import Stage
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
    apart = Apart(siblings)
    return {stage.key: apart.label(stage) for stage in siblings}


class Apart:
    """What sets stages of one detector and name apart.

    Args:
        stages: all of them.
    """

    def __init__(self, stages: Iterable[Stage]) -> None:
        first: dict[
            tuple[str, str], dict[str, str]
        ] = {}  # of each key the value that was met first
        self._differing: dict[tuple[str, str], set[str]] = {}
        for stage in stages:
            kind = _kind(stage)
            seen = first.setdefault(kind, {})
            differing = self._differing.setdefault(kind, set())
            for key, value in leaves(stage.config):
                text = repr(value)
                if seen.setdefault(key, text) != text:
                    differing.add(key)

    def label(self, stage: Stage) -> str:
        """Its detector where it comes first, its name, and the values that differ."""
        differing = self._differing[_kind(stage)]
        own = {key: value for key, value in leaves(stage.config) if key in differing}
        values = [f"{key}={own[key]}" for key in sorted(own)]
        detector = [stage.class_name] if stage.parent is None else []
        return " ".join([*detector, stage.name, *values])


def _kind(stage: Stage) -> tuple[str, str]:
    return f"{stage.target} {stage.class_name}", stage.name
