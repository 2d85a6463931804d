"""How long stages take together: as a launcher starts them, on some slots."""

from __future__ import annotations

import heapq
from collections.abc import Mapping

from fl3d.sweep.plan import Plan, longest_paths


def makespan(plan: Plan, seconds: Mapping[str, float], slots: int) -> float:
    """Time until all is done: stages start when their parent has ended, longest path first, on as many slots.

    Args:
        plan: of the sweep.
        seconds: still to go for each stage; those without an entry are done.
        slots: stages at once.
    """
    longest = longest_paths(plan, seconds)
    children: dict[str | None, list[str]] = {}
    for key in seconds:
        parent = plan.stages[key].parent
        children.setdefault(parent if parent in seconds else None, []).append(key)
    ready = [(-longest[key], key) for key in children.get(None, [])]
    heapq.heapify(ready)
    running, now = list[tuple[float, str]](), 0.0
    while ready or running:
        while ready and len(running) < slots:
            _, key = heapq.heappop(ready)
            heapq.heappush(running, (now + seconds[key], key))
        now, key = heapq.heappop(running)
        for child in children.get(key, []):
            heapq.heappush(ready, (-longest[child], child))
    return now
