"""In which phases a sweep is, by the files that lie there: so that kills get to all of them."""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path

from tests.campaigns.checks import holder

RECENT = 0.3  # seconds: a database written since then is being written
FIRST = ("planning", "simulating", "opening")  # come once in a start
PHASES = (
    "planning",  # from the start to the frozen plan
    "simulating",
    "opening",  # the store: MLflow's tables are made
    "training",
    "detecting",
    "scoring",
    "recording",
    "closing",  # all stages are done: models, pictures, tables, verdicts
)


def phases(work: Path, began: float) -> dict[str, set[int]]:
    """The phases that a sweep is in, each with the processes of the stages that are in it.

    Args:
        work: holds ``runs`` and, where it simulates, ``data``.
        began: seconds since 1970 at which the sweep was started last.
    """
    root = work / "runs"
    found: dict[str, set[int]] = {}
    simulating = [holder(path) for path in (work / "data").glob(".*.lease")]
    if any(simulating):
        found["simulating"] = {pid for pid in simulating if pid}
    is_planned = any(_changed(path) >= began for path in (root / "plans").glob("*.json"))
    if (root / ".mlflow.db.lease").exists():
        found["opening"] = set()
    elif not is_planned and not simulating:
        found["planning"] = set()
    for stage in (root / "stages").glob("*"):
        pid = holder(stage / "lease.json")
        if pid is not None and is_planned:
            found.setdefault(_of_stage(stage), set()).add(pid)
    if is_planned and _is_being_written(root):
        found["recording"] = set()
    if is_planned and _is_trained(root):
        found["closing"] = set()
    return found


def _of_stage(stage: Path) -> str:
    """What a stage does: its weights come first, then detections, scores and the marker."""
    marker = _newest(stage, "checkpoints/*.json")
    weights = _newest(stage, "checkpoints/*.pt")
    detections = _newest(stage, "detections/*.parquet")
    if detections > marker:
        return "scoring"
    return "detecting" if weights > marker else "training"


def _newest(stage: Path, pattern: str) -> str:
    return max((path.stem for path in stage.glob(pattern) if path.stem.isdigit()), default="")


def _is_trained(root: Path) -> bool:
    """Whether all stages that a plan names are done."""
    for path in (root / "plans").glob("*.json"):
        with contextlib.suppress(OSError, ValueError, KeyError):
            trials = json.loads(path.read_text())["trials"]
            named = {key for trial in trials for key in trial["stages"]}
            if any(not (root / "stages" / key / "done.json").exists() for key in named):
                return False
    return True


def _is_being_written(root: Path) -> bool:
    now = time.time()
    return any(now - _changed(root / f"mlflow.db{end}") < RECENT for end in ("", "-wal"))


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
