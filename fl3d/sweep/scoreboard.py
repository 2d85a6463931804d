"""The scores of checkpoints on disk under one protocol: made where they are missing, read once."""

from __future__ import annotations

import contextlib
import time
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, replace

from fl3d.core.errors import CheckpointError, DataError
from fl3d.core.records import Stage
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.validation import Validation
from fl3d.inference.scores import scores_of
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import end_of

LISTED_SECONDS = 90.0  # NFS keeps a listing for up to 60 (acdirmax)
LIST_AGAIN_SECONDS = 0.5

SETTLED_SECONDS = 2.0  # a folder's time is that of a tick: what comes within it would not be seen

APs = dict[str, float]
_Row = tuple[tuple[str, ...], "array[float]"]


@dataclass(frozen=True)
class _Listing:
    """Steps of a folder that was last changed at a time of its own, first and last seen so by this process's clock."""

    changed: int
    first: float
    listed: float
    steps: list[int]


class Scoreboard:
    """Scores of all stages of a store folder; what was read of one is kept until it is let go.

    Args:
        layout: of the store folder.
        validation: frames that scores are on.
        protocol: of the scores.
    """

    def __init__(self, layout: StoreFolder, validation: Validation, protocol: Protocol) -> None:
        self.layout = layout
        self.validation = validation
        self.protocol = protocol
        # Of each stage's checkpoints the metrics' names, which all share, and their numbers: a dict of each took ten
        # times as much.
        self._read: dict[str, dict[int, _Row]] = {}
        self._names: dict[tuple[str, ...], tuple[str, ...]] = {}
        self._steps: dict[str, _Listing] = {}
        self._told: dict[str, int] = {}

    def folder(self, key: str) -> RunFolder:
        """Run folder of a stage."""
        return self.layout.run(key)

    def steps(self, key: str) -> list[int]:
        """Steps of a stage's checkpoints; its folder is listed again only when it has changed."""
        folder = self.folder(key)
        try:
            changed = folder.marker(0).parent.stat().st_mtime_ns
        except FileNotFoundError:
            return []
        known, now = self._steps.get(key), time.monotonic()
        if known is None or known.changed != changed:
            known = self._steps[key] = _Listing(changed, now, now, folder.steps())
        elif known.listed - known.first < SETTLED_SECONDS:
            known = self._steps[key] = replace(known, listed=now, steps=folder.steps())
        return known.steps

    def all_steps(self, key: str) -> list[int]:
        """As ``steps``, of a stage that has ended; its last is waited for where a network's folder is listed late."""
        folder = self.folder(key)
        end = end_of(folder)
        deadline = time.monotonic() + LISTED_SECONDS
        steps = folder.steps()
        while end is not None and end not in steps and time.monotonic() < deadline:
            if not folder.marker(end).exists():
                break  # somebody has deleted it
            time.sleep(LIST_AGAIN_SECONDS)
            steps = folder.steps()
        return steps

    def changed(self, keys: Iterable[str]) -> set[str]:
        """Stages among some that have other checkpoints than when this was asked last."""
        steps = {key: len(self.steps(key)) for key in keys}
        found = {key for key, count in steps.items() if count != self._told.get(key, 0)}
        self._told = steps
        return found

    def aps(self, key: str, step: int) -> APs:
        """APs of a stage's checkpoint, such as ``ap_3d/moderate``, in percent."""
        rows = self._read.setdefault(key, {})
        row = rows.get(step)
        if row is None:
            found = scores_of(self.folder(key), step, self.validation, self.protocol)
            names = self._names.setdefault(tuple(found), tuple(found))
            row = rows[step] = names, array("d", found.values())
        return dict(zip(*row, strict=True))

    def let_go(self, key: str) -> None:
        """Keep nothing of a stage that is hardly asked for any more; from any thread."""
        self._read.pop(key, None)
        self._steps.pop(key, None)

    def curve(self, stage: Stage) -> dict[int, APs]:
        """APs of a stage's checkpoints so far, by its own epochs; those that cannot be read are left out."""
        found = {}
        steps = self.steps(stage.key)
        if stage.end_step not in steps and self.folder(stage.key).is_done:
            steps = self.all_steps(stage.key)
        for step in steps:
            with contextlib.suppress(CheckpointError, DataError):  # the recorder says so, once
                found[stage.own_epoch(step)] = self.aps(stage.key, step)
        return found
