"""Which stages of a growing plan may start, longest remaining path first: each is looked at when something changes."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterator

from fl3d.core.records import Stage
from fl3d.sweep.plan import Plan, longest_paths

# Of a sweep's time goes to reckoning how long its paths are, at most: predictions improve as stages end.
SHARE = 0.02


class Ready:
    """A queue of stages, by the predicted time from each to the end of its branch.

    Args:
        seconds: predicted for each stage.
    """

    def __init__(self, seconds: Callable[[Stage], float]) -> None:
        self._seconds = seconds
        self._plan: Plan | None = None
        self._children: dict[str | None, list[str]] = {}
        self._longest: dict[str, float] = {}
        self._place: dict[str, int] = {}  # among equals the plan's order counts
        self._heap: list[tuple[float, int, str]] = []
        self._queued: set[str] = set()
        self._reckon_at = 0.0

    def grow(self, plan: Plan) -> list[str]:
        """Take a plan that has grown; keys of the stages that are new, in its order."""
        if plan is self._plan:
            return []
        self._plan = plan
        new = [key for key in plan.stages if key not in self._place]
        for key in new:
            self._place[key] = len(self._place)
            self._children.setdefault(plan.stages[key].parent, []).append(key)
        if new:
            self._reckon_at = 0.0
        return new

    def has_seen(self, plan: Plan) -> bool:
        """Whether all stages of a plan were taken."""
        return plan is self._plan or self._place.keys() >= plan.stages.keys()

    def children(self, key: str | None) -> list[str]:
        """Stages that resume from one."""
        return self._children.get(key, [])

    def descendants(self, key: str) -> list[str]:
        """All stages that lead back to one, in the plan's order."""
        found: list[str] = []
        left = [key]
        while left:
            below = self.children(left.pop())
            found += below
            left += below
        return sorted(found, key=self._place.__getitem__)

    def add(self, key: str) -> None:
        """Queue a stage, unless it is queued."""
        if key not in self._queued:
            self._queued.add(key)
            heapq.heappush(self._heap, self._entry(key))

    def drain(self) -> Iterator[str]:
        """Take stages out, longest path first."""
        while self._heap:
            self._reckon()
            _, _, key = heapq.heappop(self._heap)
            self._queued.discard(key)
            yield key

    def _entry(self, key: str) -> tuple[float, int, str]:
        return -self._longest.get(key, 0.0), self._place[key], key

    def _reckon(self) -> None:
        """Predict anew, where that is due."""
        started = time.monotonic()
        if self._plan is None or started < self._reckon_at:
            return
        stages = self._plan.stages
        seconds = {key: self._seconds(stage) for key, stage in stages.items()}
        self._longest = longest_paths(self._plan, seconds)
        self._heap = [self._entry(key) for key in self._queued]
        heapq.heapify(self._heap)
        took = time.monotonic() - started
        self._reckon_at = started + took / SHARE
